"""The bundled cone frustum: what its script makes, and the geometry of the standard's test piece."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.reference import sorby_forward
from tests.truth import run_iso
from twin.samples import cone_frustum

FOLDER = Path(cone_frustum.__file__).parent


def test_the_files_are_what_the_script_makes() -> None:
    assert (FOLDER / "cone_frustum.cls").read_text() == cone_frustum.apt()
    assert (FOLDER / "cone_frustum.h").read_text() == cone_frustum.heidenhain()
    assert (FOLDER / "cone_frustum.nc").read_text() == cone_frustum.iso()


def test_it_is_a_cone_frustum_of_half_apex_15_inclined_10() -> None:
    """From the axis words alone, through Sørby's closed form: the tool's flank touches the cone, its axis along a generator."""
    words = [q for code, q in run_iso((FOLDER / "cone_frustum.nc").read_text()) if code == "G1"]
    lean = np.radians(10.0)
    cone_axis = np.array([np.sin(lean), 0.0, np.cos(lean)])
    base = np.array(cone_frustum.CENTRE_MM)
    cut = 0
    for q in words:
        joint = (q - [250, 225, -400, 0, 0]) * [1, 1, 1, np.pi / 180, np.pi / 180]
        joint[2] -= cone_frustum.TOOL_LENGTH_MM
        tip, axis = sorby_forward(joint)
        apex_angle = np.degrees(np.arccos(axis @ cone_axis))
        assert abs(apex_angle - 15.0) < 2e-3  # B and C are printed to 0.001°
        # Distance of the tool's centre line from the cone's surface, at the tip: the tool's radius.
        apex = base + cone_axis * 40.0 / np.tan(np.radians(15.0))
        from_apex = tip - apex
        down = -from_apex @ cone_axis
        across = np.linalg.norm(from_apex + down * cone_axis)
        distance = across * np.cos(np.radians(15.0)) - down * np.sin(np.radians(15.0))
        if abs(distance - 10.0) < 2e-3:  # X, Y, Z are printed to 0.001 mm
            cut += 1
    assert cut == 361  # one turn in steps of one degree, both ends
