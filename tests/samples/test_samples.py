"""Sample data of twin: output of the scripts, geometry of the standard's test piece, and the thesis's measurement plan."""

from __future__ import annotations

import numpy as np
import pytest

from tests.samples import cone_frustum
from tests.thermal.machine_room import warm_up
from tests.truth.machine import run_iso
from tests.truth.reference import sorby_forward
from twin.identification.thesis import three_point
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.table import Measurements
from twin.samples import RECORDS, shop_table, thesis_plan

FOLDER = cone_frustum.FOLDER


def test_the_files_equal_the_output_of_the_script() -> None:
    assert (FOLDER / "cone_frustum.cls").read_text() == cone_frustum.apt()
    assert (FOLDER / "cone_frustum.h").read_text() == cone_frustum.heidenhain()
    assert (FOLDER / "cone_frustum.nc").read_text() == cone_frustum.iso()


def test_the_table_of_a_workshop_equals_the_output_of_its_script() -> None:
    assert (FOLDER / "shop_table.csv").read_bytes() == shop_table.content()


def test_the_records_of_a_machine_that_warms_up_are_those_of_the_simulated_machine() -> None:
    columns = warm_up()
    rows = np.concatenate([np.loadtxt(path, delimiter=",", skiprows=1) for path in RECORDS])
    assert RECORDS[0].read_text().partition("\n")[0] == ",".join(columns)
    assert rows == pytest.approx(np.stack(list(columns.values()), axis=1), abs=1e-3)


def test_it_is_a_cone_frustum_of_half_apex_15_inclined_10() -> None:
    """From the axis words alone, by Sørby's closed form: the tool's flank touches the cone, its axis along a generator."""
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


def test_the_plan_equals_the_output_of_the_script() -> None:
    assert (FOLDER / "thesis_plan.csv").read_text() == thesis_plan.text()


def test_the_plan_is_that_of_the_thesis(dmu50: Machine) -> None:
    plan = Measurements.load(FOLDER / "thesis_plan.csv", dmu50, plan=True)
    assert not plan.set_aside and not plan.notices
    assert len(plan) == 4 * 3 * (11 + 11 + 11 + 19 + 18)
    assert set(plan.station) == {"1"} and set(plan.round) == {"1", "2", "3", "4"}
    assert np.all(np.diff(plan.time_s) == 15.0)
    for column, (name, low, high, count) in enumerate(
        (("X", 0, 500, 11), ("Y", 0, 450, 11), ("Z", -400, 0, 11), ("B", 0, 180, 19), ("C", 0, 340, 18))
    ):
        of = np.flatnonzero(plan.approach[:, column])
        q = plan.positions[of]
        assert np.unique(q[:, column]).tolist() == np.linspace(low, high, count).tolist()
        assert set(plan.carrier[of]) == {"tool" if name in "XYZ" else "work"}
        others = np.delete(q, column, axis=1)
        assert np.all(others == (0.0 if name in "XYZ" else [0.0, 450.0, 0.0, 0.0]))
        # each target goes through all positions, in the direction it says, before the next
        runs = q[:, column].reshape(4, 3, count)
        assert np.all(np.sign(np.diff(runs, axis=2)) == plan.approach[of[0], column])
        assert np.all(plan.target[of].reshape(4, 3, count) == plan.target[of].reshape(4, 3, count)[:, :, :1])
    assert np.count_nonzero(plan.approach) == len(plan)


def test_the_six_equations_hold_everywhere_on_the_plan(dmu50: Machine) -> None:
    """Unit noise in a reading is at most 1.8 in a translation at every position (2.5 would still hold with places a third apart)."""
    plan = Measurements.load(FOLDER / "thesis_plan.csv", dmu50, plan=True)
    for places in (thesis_plan.TOOL_PLACES_MM, thesis_plan.WORK_PLACES_MM):
        assert len({place[2] for place in places.values()}) == 3
        for name, place in places.items():
            assert np.all(plan.place_mm[plan.target == name] == place)
    worst = 0.0
    tool, work = (np.array(list(p.values())) * 1e-3 for p in (thesis_plan.TOOL_PLACES_MM, thesis_plan.WORK_PLACES_MM))
    for axis in ("X", "Y", "Z"):
        worst = max(worst, np.linalg.norm(three_point(np.eye(9).reshape(9, 3, 3), tool, axis)[:, :3], axis=0).max())
    h = np.sqrt(0.5)
    in_b = (work - [0.0, 0.0, 0.154996]) @ np.array([[1.0, 0.0, 0.0], [0.0, h, -h], [0.0, h, h]])
    for places, angles in ((work, -thesis_plan.POSITIONS["C"]), (in_b, thesis_plan.POSITIONS["B"])):
        for angle in np.radians(angles):
            c, s = np.cos(angle), np.sin(angle)
            turned = places @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
            made = three_point(np.eye(9).reshape(9, 3, 3), turned, "rotary")
            worst = max(worst, np.linalg.norm(made[:, :3], axis=0).max())
    assert worst < 1.8


def test_the_three_positions_of_figure_5_1() -> None:
    """Tables 5.1, 5.2: Pos. 1 measures y without the tracker's angles, Pos. 2 x, Pos. 3 z: a fifth of the others over the volume.

    At the limits of travel the beam is inclined by 8°, which adds 13.5 µm · sin 8° = 2 µm of the error of the angles.
    """
    points = np.array([[x, y, z] for x in (-250, 0, 250) for y in (-225, 0, 225) for z in (0, 200, 400)], dtype=float)
    for station, along in zip(thesis_plan.thesis_stations(), (1, 0, 2), strict=True):
        seen = station.to_station_mm(points)
        assert np.abs(np.linalg.norm(seen, axis=1) - 2000.0).max() < 350.0
        assert np.all(seen[:, 0] > 1500.0)  # x of the station's frame points at the machine
        turn = station.to_station_mm(np.eye(3) + station.origin_mm)
        u = np.sqrt(np.einsum("ij,njk,ik->ni", turn, LaserTracker().covariance(seen * 1e-3), turn))
        across = np.delete(u, along, axis=1)
        assert np.all(u[:, [along]] < across / 4.0)
