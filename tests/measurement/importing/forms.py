"""One table of a trunnion machine in the forms in which other programs write it, by writers that share no code with `twin`.

The readings follow from the geometry written out here (plain numpy): X and Z carry the tool, Y carries A, and A carries C.
"""

from __future__ import annotations

import csv
import io
import re
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

MACHINE = "trunnion_ac"
PLACES = {
    "K1": (110.0, 40.0, -20.0),
    "K2": (-90.0, 70.0, -120.0),
    "T1": (180.0, 30.0, 60.0),
    "T2": (-100.0, 150.0, 90.0),
}
"""Places of the reflectors, mm: K at the spindle nose, T on the table."""
ORIGIN = np.array([2500.0, -900.0, 350.0])
SIDE = {"K": "tool", "T": "work"}
AXES = "XYZAC"


def about(axis: int, deg: float) -> np.ndarray:
    """Return the rotation about x (0) or z (2)."""
    c, s = np.cos(np.radians(deg)), np.sin(np.radians(deg))
    flat = np.array([[c, -s], [s, c]])
    turn = np.eye(3)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    turn[np.ix_([i, j], [i, j])] = flat
    return turn


STATION = about(2, 38.0) @ about(0, 2.0)
"""Rotation of the tracker's frame, right-handed."""


def point(q: Sequence[float], target: str) -> np.ndarray:
    """Return a reflector in the base frame, mm."""
    x, y, z, a, c = q
    place = np.array(PLACES[target])
    if target.startswith("K"):
        return np.array([x - 300.0, 0.0, z + 450.0]) + place
    pivot = np.array([0.0, 0.0, 60.0])
    return np.array([0.0, 250.0 - y, 0.0]) + pivot + about(0, -a) @ (about(2, -c) @ place - pivot)


@dataclass(frozen=True)
class Table:
    """Rows of a measurement: (n, 5) commands, (n,) targets, (n, 3) deviations from nominal in the base frame, mm, and (n,) rounds."""

    q: np.ndarray
    target: tuple[str, ...]
    deviation: np.ndarray
    round: tuple[str, ...]

    @property
    def side(self) -> list[str]:
        return [SIDE[name[0]] for name in self.target]

    @property
    def base(self) -> np.ndarray:
        """(n, 3) points in the base frame."""
        return np.array([point(q, name) for q, name in zip(self.q, self.target, strict=True)]) + self.deviation

    @property
    def xyz(self) -> np.ndarray:
        """(n, 3) readings of the tracker, mm, to 0.1 µm."""
        return np.round((self.base - ORIGIN) @ STATION, 4)

    def take(self, rows: Sequence[int]) -> Table:
        """Return some of the rows."""
        some = list(rows)
        return replace(
            self,
            q=self.q[some],
            target=tuple(self.target[i] for i in some),
            deviation=self.deviation[some],
            round=tuple(self.round[i] for i in some),
        )


def table(rounds: int = 1) -> Table:
    """Return 42 points a round: two reflectors in the spindle, two on the table."""
    rng, q, names, which = np.random.default_rng(3), [], [], []
    tool = [(x, 250, z, 0, 0) for x in (0, 150.5, 300, 450, 600) for z in (-400, -200)]
    work = [
        (300, y, -200, a, c)
        for y, a, c in [(50, 0, 0), (450, 0, 0), *((250, a, c) for a in (-90, -45, 0) for c in (0, 90, 210))]
    ]
    for k in range(rounds):
        for name in PLACES:
            own = tool if name.startswith("K") else work
            q += own
            names += [name] * len(own)
            which += [str(k + 1)] * len(own)
    commands = np.array(q, dtype=float)
    return Table(commands, tuple(names), rng.normal(0.0, 0.004, (len(names), 3)), tuple(which))


def text(value: float, digits: int, sign: str = ".") -> str:
    """Return a number with a fixed number of decimals and a decimal sign."""
    return f"{value:.{digits}f}".replace(".", sign)


def csv_text(rows: Sequence[Sequence[object]], delimiter: str = ";", end: str = "\r\n") -> str:
    """Return rows as delimited text."""
    out = io.StringIO()
    csv.writer(out, delimiter=delimiter, lineterminator=end).writerows(rows)
    return out.getvalue()


def name_of(q: Sequence[float], target: str, style: str = "{X}_{Y}_{Z}_{A}_{C}_{name}", sign: str = ".") -> str:
    """Return the name of a point that holds its position."""
    parts = {axis: f"{axis}{value:g}".replace(".", sign) for axis, value in zip(AXES, q, strict=True)}
    return style.format(**parts, name=target)


def named_points(
    own: Table,
    style: str = "{X}_{Y}_{Z}_{A}_{C}_{name}",
    delimiter: str = "\t",
    sign: str = ",",
    head: str = "Einheit:\tmm",
) -> str:
    """Inspection program: title rows, positions in the names of the points, coordinates without unit in the header."""
    rows: list[Sequence[object]] = [["Name", "X", "Y", "Z"]]
    rows += [
        [name_of(q, name, style), *(text(v, 4, sign) for v in p)]
        for q, name, p in zip(own.q, own.target, own.xyz, strict=True)
    ]
    return f"Programm 2022\r\nProjekt:{delimiter}Abnahme\r\n{head}\r\n\r\n" + csv_text(rows, delimiter)


LENGTHS = {"mm": 1.0, "in": 25.4, "µm": 1e-3, "m": 1e3, "inch": 25.4, "um": 1e-3}
ANGLES = {"°": 1.0, "deg": 1.0, "rad": 180.0 / np.pi, "''": 1.0 / 3600.0, "gon": 0.9, "'": 1.0 / 60.0}


def cells_with_units(own: Table, length: str = "mm", angle: str = "°", blank: str = " ", sign: str = ".") -> str:
    """Every number has its unit in the cell, none in the header."""
    size, turn = LENGTHS[length], ANGLES[angle]
    rows: list[Sequence[object]] = [
        [
            "Machine position X",
            "Machine position Y",
            "Machine position Z",
            "A",
            "C",
            "SMR",
            "x meas",
            "y meas",
            "z meas",
        ]
    ]
    for q, name, p in zip(own.q, own.target, own.xyz, strict=True):
        digits = 9
        rows.append(
            [
                *(f"{text(v / size, digits, sign)}{blank}{length}" for v in q[:3]),
                *(f"{text(v / turn, digits, sign)}{blank}{angle}" for v in q[3:]),
                name,
                *(f"{text(v / size, digits, sign)}{blank}{length}" for v in p),
            ]
        )
    return csv_text(rows)


def sexagesimal(deg: float) -> str:
    """Return an angle in degrees, minutes and seconds."""
    whole = round(abs(deg) * 3600.0 * 1e4)
    minutes, seconds = divmod(whole, 60 * 10**4)
    degrees, minutes = divmod(minutes, 60)
    return f"{'-' if deg < 0 else ''}{degrees}°{minutes:02d}'{seconds / 1e4:07.4f}\""


def packed(deg: float) -> str:
    """Degrees, minutes and seconds as a theodolite shows them: 45.30300 is 45° 30′ 30″."""
    minutes, seconds = divmod(round(abs(deg) * 3600e4), 60 * 10**4)
    degrees, minutes = divmod(minutes, 60)
    return f"{'-' if deg < 0 else ''}{degrees}.{minutes:02d}{seconds:06d}"


def spherical(
    own: Table, angle: str = "deg", clockwise: bool = False, zenith: bool = True, length: str = "m", stated: bool = True
) -> str:
    """Instrument: horizontal angle, vertical angle and distance."""
    p = own.xyz
    distance = np.linalg.norm(p, axis=1)
    hz = np.degrees(np.arctan2(p[:, 1], p[:, 0])) * (-1.0 if clockwise else 1.0) % 360.0
    v = np.degrees(np.arccos(p[:, 2] / distance))
    v = v if zenith else 90.0 - v
    unit = f" [{angle}]" if stated and angle != "dms" else ""
    rows: list[Sequence[object]] = [
        [
            *(f"{a} soll" for a in AXES),
            "Reflektor",
            f"Hz{unit}",
            f"V{unit}",
            f"Distanz [{length}]" if stated else "Distanz",
        ]
    ]
    for i in range(len(p)):
        spelt = {"dms": sexagesimal, "d.mmss": packed}.get(angle) or (lambda one: text(one / ANGLES[angle], 9))
        angles = [spelt(one) for one in (hz[i], v[i])]
        rows.append(
            [*(f"{value:g}" for value in own.q[i]), own.target[i], *angles, text(distance[i] / LENGTHS[length], 7)]
        )
    return csv_text(rows, ";", "\n")


def deviations(own: Table, unit: str = "µm", sign: str = ",") -> str:
    """Nominal positions and deviations in the machine's directions."""
    rows: list[Sequence[object]] = [
        ["Punkt", "Reflektor", *(f"{a} nom" for a in AXES), *(f"d{a} [{unit}]" for a in "XYZ")]
    ]
    for i, (q, name, d) in enumerate(zip(own.q, own.target, own.deviation, strict=True)):
        rows.append([f"P{i + 1}", name, *(text(v, 3, sign) for v in q), *(text(v / LENGTHS[unit], 4, sign) for v in d)])
    return csv_text(rows)


def blocks(own: Table) -> str:
    """One heading with the position above the points measured there, the header of the points repeated."""
    rows: list[Sequence[object]] = [["Tracker log"]]
    before: tuple[float, ...] = ()
    for q, name, p in zip(own.q, own.target, own.xyz, strict=True):
        if tuple(q) != before:
            rows += [
                ["Position " + " ".join(f"{a} = {v:g}" for a, v in zip(AXES, q, strict=True))],
                ["Target", "x [mm]", "y [mm]", "z [mm]"],
            ]
            before = tuple(q)
        rows.append([name, *(text(v, 4) for v in p)])
    return csv_text(rows, ",")


TITLES = {
    "German": (*(f"{a}-Soll" for a in AXES), "Reflektor", *(f"{a}-Ist" for a in "XYZ"), "Durchgang"),
    "English": (*(f"{a} nominal" for a in AXES), "Reflector", *(f"{a} actual" for a in "XYZ"), "Run"),
    "French": (*(f"{a} théorique" for a in AXES), "Réflecteur", *(f"{a} mesuré" for a in "XYZ"), "Essai"),
    "consigne": (*(f"Consigne {a}" for a in AXES), "Réflecteur n°", *(f"{a} réel" for a in "XYZ"), "Passe"),
}  # fmt: skip


def titled(
    own: Table, language: str, head: Sequence[str] = (), delimiter: str = ";", sign: str = ",", scale: float = 1.0
) -> str:
    """Plain table with titles in a language, without units in the header."""
    rows: list[Sequence[object]] = [*([line] for line in head), TITLES[language]]
    for q, name, p, k in zip(own.q, own.target, own.xyz, own.round, strict=True):
        rows.append(
            [
                *(text(v / scale, 7, sign) for v in q[:3]),
                *(text(v, 3, sign) for v in q[3:]),
                name,
                *(text(v / scale, 7, sign) for v in p),
                k,
            ]
        )
    return csv_text(rows, delimiter)


def workbook(path: Path, own: Table, *, merged: bool = True, last: bool = True, other: bool = False) -> None:
    """Workbook: two header rows with merged cells, a row of units, the last column titled above only."""
    from openpyxl import Workbook

    book = Workbook()
    sheet = book.active
    sheet.title = "Messdaten"
    sheet.append(
        [
            "Pos.",
            "Standpunkt",
            "Soll",
            None,
            None,
            None,
            None,
            "Reflektor",
            "Ist",
            None,
            None,
            *(["Temperatur"] if last else []),
        ]
    )
    sheet.append([None, None, *AXES, None, *"XYZ"])
    sheet.append([None, None, "mm", "mm", "mm", "°", "°", None, "mm", "mm", "mm", *(["°C"] if last else [])])
    for i, (q, name, p) in enumerate(zip(own.q.tolist(), own.target, own.xyz.tolist(), strict=True)):
        sheet.append([i + 1, "S1", *q, name, *p, *([20.25] if last else [])])
    if merged:
        sheet.merge_cells("C1:G1")
        sheet.merge_cells("I1:K1")
    if other:
        book.create_sheet("Notizen").append(["Bediener", "Müller"])
    book.save(path)


def with_formulas(path: Path, *, stored: bool = True) -> None:
    """Replace the numbers of column C of a workbook's first sheet by formulas, with or without their stored values."""
    with zipfile.ZipFile(path) as parts:
        content = {name: parts.read(name) for name in parts.namelist()}
    sheet = content["xl/worksheets/sheet1.xml"].decode()
    value = r"<f>\3+0</f><v>\3</v>" if stored else r"<f>\3+0</f>"
    sheet = re.sub(r'<c r="(C(?:[4-9]|\d\d+))"([^>]*)><v>([^<]*)</v>', rf'<c r="\1"\2>{value}', sheet)
    content["xl/worksheets/sheet1.xml"] = sheet.encode()
    with zipfile.ZipFile(path, "w") as parts:
        for name, data in content.items():
            parts.writestr(name, data)


# --- Positioning test of one axis ---------------------------------------------------------------------

TARGETS = np.array([10.0, 110.5, 250.0, 390.25, 590.0])
RUNS = [(run, way) for run in (1, 2, 3) for way in (1, -1)]


def errors_um() -> np.ndarray:
    """Return (runs, targets) deviations, µm: a curve, backlash of 3 µm, and noise."""
    rng = np.random.default_rng(8)
    curve = 6.0 * np.sin(TARGETS / 200.0) + 0.01 * TARGETS
    return np.round(np.array([curve + 1.5 * way + rng.normal(0.0, 0.3, len(TARGETS)) for _, way in RUNS]), 2)


def matrix(style: str, sign: str = ",", statistics: bool = True) -> str:
    """Evaluation sheet after ISO 230-2: targets against runs."""
    e = errors_um()
    head: list[Sequence[object]] = [["Positioniergenauigkeit ISO 230-2"], ["Achse: X"], ["Abweichungen in µm"]]
    number = [text(one, 3, sign) for one in TARGETS]
    values = [[text(v, 2, sign) for v in row] for row in e]
    mean = [text(v, 2, sign) for v in e.mean(axis=0)]
    if style == "columns":
        titles = [f"Lauf {run} {'↑' if way > 0 else '↓'}" for run, way in RUNS]
        rows = [["Pos.", "Sollposition [mm]", *titles, *(["Mittelwert"] if statistics else [])]]
        rows += [
            [i + 1, number[i], *(row[i] for row in values), *([mean[i]] if statistics else [])]
            for i in range(len(TARGETS))
        ]
        rows += [["", "Max", *(text(row.max(), 2, sign) for row in e)]] if statistics else []
    elif style == "groups":
        rows = [
            ["Position", *(cell for run in (1, 2, 3) for cell in (f"Run {run}", ""))],
            ["[mm]", *(["forward", "reverse"] * 3)],
        ]
        rows += [[number[i], *(row[i] for row in values)] for i in range(len(TARGETS))]
    elif style == "signs":
        rows = [["Target", *(f"{run}{'+' if way > 0 else '-'}" for run, way in RUNS)]]
        rows += [[number[i], *(row[i] for row in values)] for i in range(len(TARGETS))]
    else:
        rows = [["Sollposition [mm]", "", *number]]
        rows += [
            [f"Lauf {run}", "auf" if way > 0 else "ab", *row] for (run, way), row in zip(RUNS, values, strict=True)
        ]
        rows += [["Mittelwert", "", *mean]] if statistics else []
    return csv_text([*head, *rows])


def runs(unit: str = "µm", measured: bool = False, head: str = "Axis: X") -> str:
    """One row for each reading: target, run, direction, deviation or measured position."""
    e = errors_um()
    title = "Measured [mm]" if measured else f"Deviation [{unit}]"
    rows: list[Sequence[object]] = [[head], ["Target [mm]", "Run", "Direction", title]]
    for (run, way), row in zip(RUNS, e, strict=True):
        order = range(len(TARGETS)) if way > 0 else range(len(TARGETS) - 1, -1, -1)
        for i in order:
            value = text(TARGETS[i] + row[i] * 1e-3, 6) if measured else text(row[i] * 1e-3 / LENGTHS[unit], 6)
            rows.append([text(TARGETS[i], 3), run, "+" if way > 0 else "-", value])
    return csv_text(rows, ",")


Writer = Callable[[Table], str]
