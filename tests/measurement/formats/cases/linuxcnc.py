"""LinuxCNC probe log: nine numbers a line, here with a coordinate system that is not the machine's."""

from __future__ import annotations

from tests.measurement.formats.cases import spheres
from twin.measurement.contacts import Probing
from twin.measurement.formats import Given

FILE = "probe-results.txt"
MACHINE = "dmu50"
GIVEN = Given(offset={"X": 200.0, "Y": 200.0, "Z": -300.0}, probing=Probing(u_contact_mm=0.001))
GOOD = "".join(
    f"{p[0] - 200:f} {p[1] - 200:f} {p[2] + 300:f} 0.000000 {b:f} {c:f} 0.000000 0.000000 0.000000\n"
    for p, _, b, c in spheres.contacts()
)
ROWS = spheres.rows()
SIDES = spheres.SIDES
AGREES_MM = 1e-6
BAD = [
    ("65.000000 25", "65.000000", 1, "8 numbers"),
    ("65.000000", "65,000000", 1, "not a number"),
    ("65.000000", "nan", 1, "not a number"),
    ("100.000000 0.000000 0", "100.000000 5.000000 0", 1, "no axis A"),
    ("65.000000", "65.100000", 1, "outlier"),
]
