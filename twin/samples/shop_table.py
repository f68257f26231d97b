"""Generate ``shop_table.csv`` in this folder: run ``python -m twin.samples.shop_table``.

A simulated measurement in the form in which a German measuring program could write it: title rows, a row of units, semicolons, decimal
commas, code page 1252. It is a sample for ``twin import``. The format is that of no real program.
"""

from __future__ import annotations

import csv
import io
from typing import Final

import numpy as np

from twin._common.files import write_atomic
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.samples import PLANS, TABLES

SEED: Final = 11
SIDES: Final = {"tool": "Spindel", "work": "Tisch"}
TITLES: Final[tuple[list[str], ...]] = (
    ["Maschinenvermessung (simuliert, keine echten Messwerte)"],
    ["Prüfer:", "Müller"],
    [],
)
HEADER: Final = (
    "Nr. Messpunkt X-Soll Y-Soll Z-Soll B-Soll C-Soll Reflektor Träger X-Ist Y-Ist Z-Ist Durchgang Uhrzeit".split()
)
UNITS: Final = ["", "", "[mm]", "[mm]", "[mm]", "[°]", "[°]", "", "", "[mm]", "[mm]", "[mm]", "", ""]


def rows() -> list[list[str]]:
    """Return title rows, header, units and measured points: the first two rounds of every axis of the thesis's plan."""
    machine = Machine.load("dmu50")
    plan = Measurements.load(PLANS[0], machine, plan=True)
    plan = plan.select(np.isin(plan.round, ("1", "2")))
    calibration = Calibration.default(machine)
    found, _ = simulate(plan, machine, calibration, LaserTracker(), np.random.default_rng(SEED))
    points = []
    for i in range(len(found)):
        seconds = 28800 + round(float(found.time_s[i]))
        clock = f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
        command = [f"{value:.3f}".replace(".", ",") for value in found.positions[i]]
        point = [f"{value:.4f}".replace(".", ",") for value in found.point_mm[i]]
        names = [str(found.target[i]), SIDES[str(found.carrier[i])]]
        points.append([str(i + 1), f"P{i + 1}", *command, *names, *point, str(found.round[i]), clock])
    return [*TITLES, HEADER, UNITS, *points]


def content() -> bytes:
    """Return the content of the file."""
    out = io.StringIO()
    csv.writer(out, delimiter=";", lineterminator="\r\n").writerows(rows())
    return out.getvalue().encode("cp1252")


if __name__ == "__main__":
    write_atomic(TABLES[0], content())
