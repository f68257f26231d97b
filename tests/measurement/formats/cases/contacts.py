"""Table of single contacts; the tip's radius is compensated along the directions."""

from __future__ import annotations

from tests.measurement.formats.cases import spheres
from twin.measurement.contacts import Probing
from twin.measurement.formats import Given

FILE = "contacts.csv"
MACHINE = "dmu50"
GIVEN = Given(probing=Probing(sphere_radius_mm=12.5, tip_radius_mm=2.5, u_contact_mm=0.001))
GOOD = "contact_x_mm,contact_y_mm,contact_z_mm,B_deg,C_deg,sphere,direction_x,direction_y,direction_z\n" + "".join(
    ",".join(f"{value:.6g}" for value in (*point, b, c)) + ",S1," + ",".join(f"{-value:g}" for value in normal) + "\n"
    for point, normal, b, c in spheres.contacts()
)
ROWS = spheres.rows()
SIDES = spheres.SIDES
AGREES_MM = 1e-6
BAD = [
    ("contact_z_mm", "contact_w_mm", None, "column contact_z_mm is missing"),
    ("direction_z", "direction_w", None, "column direction_z is missing"),
    ("265,225,-200", "265,,-200", 2, "contact_y_mm is empty"),
    ("265,225,-200", "265,x,-200", 2, "contact_y_mm is not a number"),
    ("S1,-1,-0,-0", "S1,-1,-1,-0", 2, "not a unit vector"),
    ("265,225,-200", "265.05,225,-200", 2, "outlier"),
    ("265,225,-200,0,0,S1", "265,225,-200,0,0,S2", 2, "1 contact on a sphere"),
    (GOOD.partition("\n")[2], "", None, "no contacts"),
]
