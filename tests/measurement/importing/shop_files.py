"""Simulated tables in the forms in which measuring programs and workshops write them. No file is from a real program.

The readings are those of an exact machine (`points`) seen from a station, with noise: truth for the tests, computed without `twin`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

ANGLE = np.deg2rad(37.0)
STATION = np.array([[np.cos(ANGLE), -np.sin(ANGLE), 0.0], [np.sin(ANGLE), np.cos(ANGLE), 0.0], [0.0, 0.0, 1.0]])
ORIGIN = np.array([1800.0, 350.0, 380.0])
START = datetime(2026, 3, 2, 8, 15, 0)


def points(count: int = 24, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, 3) commanded X, Y, Z and (n, 3) readings in the station's frame, mm, rounded as a program writes them."""
    rng = np.random.default_rng(seed)
    q = np.round(rng.uniform([0.0, 0.0, -400.0], [500.0, 450.0, 0.0], (count, 3)), 1)
    q[0] = 0.5, 10.0, -0.5
    return q, np.round(q @ STATION.T + ORIGIN + rng.normal(0.0, 0.005, (count, 3)), 4)


def comma(value: float, digits: int = 4) -> str:
    return f"{value:.{digits}f}".replace(".", ",")


def text_of(rows: Sequence[Sequence[object]], delimiter: str = ";", end: str = "\r\n") -> str:
    out = io.StringIO()
    csv.writer(out, delimiter=delimiter, lineterminator=end).writerows(rows)
    return out.getvalue()


def cmm_report() -> bytes:
    """German coordinate measuring program: title rows, units row, cp1252, decimal comma."""
    q, m = points()
    rows: list[list[object]] = [
        ["Messprotokoll (simuliert)"],
        ["Prüfer:", "Müller", "", "Datum:", "02.03.2026"],
        ["Teil: DMU 50, Maschinenabnahme", "Temperatur 20,4 °C"],
        [],
        ["Nr.", "Messpunkt", *(f"{a}-Soll" for a in "XYZ"), *(f"{a}-Ist" for a in "XYZ"), "Abw. X", "Bemerkung"],
        ["", "", *["[mm]"] * 6, "[mm]", ""],
    ]
    for i, (c, p) in enumerate(zip(q, m, strict=True), start=1):
        rows.append(
            [i, f"P{i}", *(comma(v, 3) for v in c), *map(comma, p), comma(0.0021), "ok" if i % 5 else "Zeile\nzwei"]
        )
    rows.append(["Ende der Messung"])
    return text_of(rows).encode("cp1252")


def tracker_inches() -> bytes:
    """English tracker program: nominal and actual in inches, deviations, several targets."""
    q, m = points()
    rows: list[list[object]] = [
        ["# simulated export"],
        [
            "Name",
            *(f"Nominal {a} (in)" for a in "XYZ"),
            *(f"Actual {a} (in)" for a in "XYZ"),
            "dX",
            "dMag",
            "Timestamp",
        ],
    ]
    for i, (c, p) in enumerate(zip(q, m, strict=True)):
        when = (START + timedelta(seconds=15 * i)).strftime("%m/%d/%Y %I:%M:%S %p")
        rows.append(
            ["ABC"[i % 3], *(f"{v / 25.4:.7f}" for v in c), *(f"{v / 25.4:.7f}" for v in p), "0.0001", "0.0002", when]
        )
    return text_of(rows, ",").encode()


def analyser_points() -> bytes:
    """ASCII points with collection, group and point name, UTF-16, tabs; positions are in a plan with names of points."""
    _, m = points()
    lines = ["// simulated points, units mm", "Collection\tGroup\tPoint Name\tX [mm]\tY [mm]\tZ [mm]"]
    lines += [f"A\tRound 1\tp{i:02d}\t" + "\t".join(f"{v:.4f}" for v in p) for i, p in enumerate(m)]
    return ("\r\n".join(lines) + "\r\n").encode("utf-16")


def analyser_plan() -> str:
    """Plan for `analyser_points`, in another order."""
    q, _ = points()
    rows = [f"{c[0]},{c[1]},{c[2]},0,0,K,tool,p{i:02d}" for i, c in enumerate(q)]
    return "X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,point\n" + "\n".join(reversed(rows)) + "\n"


def bare_points() -> bytes:
    """Lines of a name and three coordinates, without header."""
    _, m = points()
    return "".join(f"K{i},{p[0]:.4f},{p[1]:.4f},{p[2]:.4f}\n" for i, p in enumerate(m)).encode()


def order_plan() -> str:
    """Plan for `bare_points`, in the same order and without names of points."""
    lines = analyser_plan().splitlines()
    return "\n".join(line.rpartition(",")[0] for line in [lines[0], *lines[:0:-1]]) + "\n"


def notebook() -> bytes:
    """Typed table: decimal commas, semicolons, no units, commands in capitals and readings in small letters, UTF-8 with BOM."""
    q, m = points()
    rows: list[list[object]] = [["X", "Y", "Z", "B", "C", "x", "y", "z", "Reflektor", "Richtung X"]]
    for i, (c, p) in enumerate(zip(q, m, strict=True)):
        rows.append([*(comma(v, 1) for v in c), "0", "0", *map(comma, p), "KPQ"[i % 3], "+" if i % 2 else "-"])
    return text_of(rows, ";", "\n").encode("utf-8-sig")


def metres_and_radians() -> bytes:
    """Export in SI units without any unit: metres and radians, blanks between columns."""
    q, m = points()
    lines = ["nominal_X nominal_Y nominal_Z nominal_B nominal_C meas_X meas_Y meas_Z"]
    for i, (c, p) in enumerate(zip(q, m, strict=True)):
        turn = np.deg2rad([7.0 * i, 0.0])
        lines.append(" ".join(f"{v:.7f}" for v in (*(c / 1e3), *turn, *(p / 1e3))))
    return ("\n".join(lines) + "\n").encode()


def mirrored_depth() -> bytes:
    """Depth counted downwards: commanded Z is positive, and outside the machine's range."""
    q, m = points()
    rows: list[list[object]] = [[*(f"{a} nominal [mm]" for a in "XYZ"), *(f"{a} actual [mm]" for a in "XYZ")]]
    rows += [[c[0], c[1], -c[2], *p] for c, p in zip(q.tolist(), m.tolist(), strict=True)]
    return text_of(rows, "\t").encode()


def mirrored_reading(axis: int = 2) -> bytes:
    """Complete table whose readings are in a frame of the other hand, aligned with the machine."""
    q, _ = points()
    m = q + np.random.default_rng(5).normal(0.0, 0.004, q.shape)
    m[:, axis] *= -1.0
    rows: list[list[object]] = [["X_mm", "Y_mm", "Z_mm", "B_deg", "C_deg", "target", "carrier", "x_mm", "y_mm", "z_mm"]]
    rows += [[*c, 0, 0, "K", "tool", *p] for c, p in zip(q.tolist(), m.tolist(), strict=True)]
    return text_of(rows, ",").encode()


def grouped_thousands() -> bytes:
    """Swiss and German thousands: apostrophes and points, decimal comma."""
    q, m = points()
    rows: list[list[object]] = [
        ["Punkt", *(f"{a} Sollwert (mm)" for a in "XYZ"), *(f"{a} Messwert (mm)" for a in "XYZ")]
    ]
    for i, (c, p) in enumerate(zip(q, m, strict=True)):
        rows.append(
            [f"P{i}", *(comma(v, 2) for v in c), *(f"{v:,.4f}".translate(str.maketrans(",.", ".,")) for v in p)]
        )
    return text_of(rows).encode("latin-1")


def workbook(path: Path) -> None:
    """German workbook: an empty first sheet, title rows, a header of two rows, units, dates as dates."""
    from openpyxl import Workbook

    q, m = points()
    book = Workbook()
    book.active.title = "Deckblatt"
    book["Deckblatt"].append(["Maschinenabnahme (simuliert)"])
    sheet = book.create_sheet("Messung")
    sheet.append(["Messprotokoll Lasertracker"])
    sheet.append([])
    sheet.append(["", "", "Soll", "", "", "", "", "Ist", "", "", "Temperatur", "Unsicherheit"])
    sheet.append(["Datum/Uhrzeit", "Reflektor", "X", "Y", "Z", "B", "C", "X", "Y", "Z", "Bett", "Z"])
    sheet.append(["", "", "mm", "mm", "mm", "°", "°", "mm", "mm", "mm", "°C", "µm"])
    for i, (c, p) in enumerate(zip(q.tolist(), m.tolist(), strict=True)):
        sheet.append([START + timedelta(seconds=20 * i), "KPQ"[i % 3], *c, 0, 0, *p, 20.5 + i / 100, 4.5])
    book.save(path)


FILES: dict[str, Callable[[], bytes]] = {
    "cmm.csv": cmm_report,
    "inches.csv": tracker_inches,
    "points.txt": analyser_points,
    "bare.csv": bare_points,
    "notebook.csv": notebook,
    "metres.txt": metres_and_radians,
    "depth.txt": mirrored_depth,
    "mirrored.csv": mirrored_reading,
    "thousands.csv": grouped_thousands,
}
