"""Log of contacts printed by FN 16 with the mask in the module's docstring."""

from __future__ import annotations

from tests.measurement.formats.cases import spheres
from twin.measurement.contacts import Probing
from twin.measurement.formats import Given

FILE = "contacts.txt"
MACHINE = "dmu50"
GIVEN = Given(probing=Probing(sphere_radius_mm=12.5, tip_radius_mm=2.5, u_contact_mm=0.001))
GOOD = "".join(
    f"CONTACT X={p[0]:+.4f} Y={p[1]:+.4f} Z={p[2]:+.4f} B={b:+.4f} C={c:+.4f} SPHERE=1\n"
    for p, _, b, c in spheres.contacts()
)
ROWS = spheres.rows()
SIDES = spheres.SIDES
AGREES_MM = 1e-6
BAD = [
    ("CONTACT", "KONTAKT", 1, "not a contact"),
    ("X=+265.0000", "X=+265,0000", 1, "X is not a number"),
    ("X=+265.0000", "U=+265.0000", 1, "unknown entry"),
    ("X=+265.0000 ", "", 1, "a contact without X"),
    ("X=+235.0000 Y=+225.0000 Z=-200.0000 B", "X=+235.0000 Y=+225.0000 Z=-200.0000 DX", 2, "other axes"),
    ("CONTACT", "Measuring log for touch probe cycle 421", 1, "log of a touch probe cycle has no sphere centres"),
]
