"""The closed loop on the control: it measures a machine with errors by twin's programs, is corrected by the result, and measures again.

The machine is ``probed.comp``, a realtime component behind the control; twin sees its answers only through the log of the control.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

import twin
from tests.linuxcnc.control import needs_linuxcnc, needs_root, skip_without_control
from tests.linuxcnc.loop import (
    ON,
    RECORD,
    centres,
    command,
    converted,
    corrected,
    joined,
    measured,
    one_loop,
    planned,
    room,
    spread_um,
    tip_of,
)
from tests.linuxcnc.machines import KINDS
from tests.linuxcnc.physical import (
    LENGTH,
    SPHERES,
    UM,
    URAD,
    Physical,
    execute,
    module,
    nominal,
    poses,
    reflectors,
    remaining_um,
    rms,
    stops,
    tips,
    tracker_program,
    visits,
    write_tracked,
)
from twin.cli.identify import tables_on

pytestmark = [needs_linuxcnc, needs_root]
SHORT = 4
"""Poses of a program that is cut short."""


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> twin.Machine:
    machine = twin.Machine.load("dmu50")
    skip_without_control(tmp_path_factory.mktemp("plain"), machine)
    return machine


@pytest.fixture(scope="module")
def physical(machine: twin.Machine, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Physical]:
    found = Physical.drawn(1)
    with found.installed(tmp_path_factory.mktemp("component")):
        yield found


def short(folder: Path) -> Path:
    """Return the first poses of a measuring program."""
    program = planned(folder, "short", "--sequence", "turns", spheres=1)
    whole = program.read_text()
    program.write_text(whole[: whole.index(f"(pose {SHORT + 1})")] + "(LOGCLOSE)\nM2\n")
    return program


def test_the_centres_in_the_log_are_those_of_the_machine(
    machine: twin.Machine, physical: Physical, tmp_path: Path
) -> None:
    """The true tip, by another code, at the centres that `convert` makes of the log is at the true spheres."""
    program = short(tmp_path)
    folder = room(tmp_path, program)
    ran = execute(
        folder, machine, physical, [["home"], ["program", program.name]], faults={"noise": 0.0, "lobing": 0.0}
    )
    assert not ran.failed, f"{ran.failed}\n{ran.log}"
    converted(tmp_path, folder / "SHORT_LOG.csv", "measured.csv")
    found, names = centres(machine, tmp_path / "measured.csv")
    assert len(found) == SHORT
    for q, name in zip(found, names, strict=True):
        sphere = int(name.removeprefix("sphere ")) - 1
        # A touch is seen once in a cycle, after 3.3 µm at most; what is alike on all sides is not in the centre but along the tool.
        assert np.linalg.norm(physical.tip(q) - physical.places[sphere]) < 0.005
        assert np.linalg.norm(physical.tip(q) - SPHERES[sphere]) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "stopped", "said"),
    [
        ({"missed": 17}, "G38.2 move finished without making contact", "1 contact on a sphere"),
        ({"sham": 13, "early": 0.2}, "", "is an outlier"),
    ],
    ids=["no contact", "contact in the air"],
)
def test_a_false_contact_makes_no_calibration(
    machine: twin.Machine, physical: Physical, tmp_path: Path, fault: Mapping[str, float], stopped: str, said: str
) -> None:
    """The control stops, or `convert` names the line of the log; no table is written."""
    program = short(tmp_path)
    folder = room(tmp_path, program)
    ran = execute(folder, machine, physical, [["home"], ["program", program.name]], faults=fault)
    assert stopped in ran.failed and bool(ran.failed) == bool(stopped)
    text = converted(tmp_path, folder / "SHORT_LOG.csv", "measured.csv", status=2)
    # The header is the first line.
    line = 1 + (fault["missed"] - 1 if stopped else fault["sham"])
    found = re.findall(r"SHORT_LOG.csv:(\d+):", text)
    assert said in text and found and (int(found[0]) == line or (not stopped and line - 5 < int(found[0]) <= line))
    assert not (tmp_path / "measured.csv").exists()


@pytest.mark.slow
def test_the_machine_is_right_after_one_loop(machine: twin.Machine, physical: Physical, tmp_path: Path) -> None:
    """1.5 µm RMS or less remain; the record that the course's notebook evaluates is of such a loop, and not older than the programs."""
    loop = one_loop(tmp_path, machine, physical)
    before, after = np.array(loop["before_um"]), np.array(loop["after_um"])
    print(f"before {rms(before):.2f} {before.max():.2f}, after {rms(after):.2f} {after.max():.2f} µm")
    assert rms(before) > 8.0 and rms(after) <= 1.5 and after.max() < 0.25 * before.max()
    first = spread_um(*centres(machine, tmp_path / "measured.csv"))
    assert first > 10.0 and spread_um(*centres(machine, tmp_path / "second.csv")) < 3.0
    kept = json.loads(RECORD.read_text())
    assert kept["tip_mm"] == loop["tip_mm"]
    for name in ("first_log", "second_log"):
        new, old = (np.array([row.split(",")[:5] for row in one[name].splitlines()[1:]], float) for one in (loop, kept))
        # Each contact has its noise, and is seen a cycle earlier or later.
        assert new.shape == old.shape and np.abs(new - old).max() < 0.02
    assert (
        abs(rms(np.array(kept["before_um"])) - rms(before)) < 0.1
        and abs(rms(np.array(kept["after_um"])) - rms(after)) < 0.5
    )


def left_um(physical: Physical, calibration: Path) -> tuple[float, float]:
    """Return the RMS error at the tool, µm, without a correction, and with one by the numbers of a calibration."""
    data = yaml.safe_load(calibration.read_text())
    square = np.array([data["squareness"].get(name, 0.0) for name in ("E_C0Y", "E_A0Z", "E_B0Z")])
    location = np.array([[data["location"].get(f"E_{letter}0{axis}", 0.0) for letter in "XYZABC"] for axis in "BC"])
    identified = replace(physical, square=square * URAD, location=location * ([UM] * 3 + [URAD] * 3))
    places = poses(100)
    true, found = (np.array([one.tip(q) for q in places]) for one in (physical, identified))
    wanted = np.array([nominal(q) for q in places])
    # Where both errors are the same the tool is right.
    return rms(remaining_um(places, true)), rms(remaining_um(places, wanted + true - found))


@pytest.mark.slow
def test_a_second_loop_corrects_what_the_machine_has_moved_since(
    machine: twin.Machine, physical: Physical, tmp_path: Path
) -> None:
    """With the module on: nothing is added while the machine is right; after a collision the sum of both corrects it."""
    tip, live_1, found = ("--tip", tip_of(physical)), "linuxcnc-kinematics=live/calibration.yaml", {}
    first, second, third = (planned(tmp_path, name, "--minutes", 30) for name in ("first", "second", "third"))
    found["before"] = measured(tmp_path, machine, physical, first, "first.csv", *tip, seed=11)
    command(tmp_path, "identify", "first.csv", "-o", "mine.yaml", "--only", "E_*0*")
    assert "add" in corrected(tmp_path, "mine.yaml", "no", "--add", status=2)
    corrected(tmp_path, "mine.yaml", "live")
    # The true locations and squareness, apart from those that were measured, by a collision.
    moved = replace(
        physical,
        square=physical.square + np.array([25.0, -20.0, 30.0]) * URAD,
        location=physical.location
        + np.array([[12, 8, 0, 20, -15, 0], [-10, 14, 0, -25, 20, 0]]) * ([UM] * 3 + [URAD] * 3),
    )
    on = ["--only", "E_*0*", "--control", live_1]
    with module(tmp_path / "live") as live:
        found["corrected"] = measured(tmp_path, machine, physical, second, "second.csv", *tip, live=live, seed=12)
        command(tmp_path, "identify", "second.csv", "-o", "right.yaml", *on)
        assert "exceeds the correction" in corrected(tmp_path, "right.yaml", "no", "--add", status=2)
        with moved.installed(tmp_path / "component"):
            found["moved"] = measured(tmp_path, machine, moved, third, "third.csv", *tip, live=live, seed=13)
    said = command(tmp_path, "identify", "third.csv", "-o", "rest.yaml", *on)
    assert "add" in corrected(tmp_path, "rest.yaml", "no", status=2) and not (tmp_path / "no").exists(), said
    corrected(tmp_path, "rest.yaml", "live2", "--add")
    with moved.installed(tmp_path / "component"), module(tmp_path / "live2") as live:
        check = planned(tmp_path, "check", "--sequence", "turns", spheres=1)
        found["second loop"] = measured(tmp_path, machine, moved, check, "check.csv", live=live, seed=14)
    for name, values in found.items():
        print(f"{name}: {rms(values):.2f} {values.max():.2f} µm")
    left = [rms(values) for values in found.values()]
    assert left[0] > 8.0 and left[1] < 1.5 and left[2] > 5.0 and left[3] < 1.5
    assert spread_um(*centres(machine, tmp_path / "check.csv")) < 3.0
    # The folder's calibration is that of the machine with the module off.
    (held,) = tables_on(["linuxcnc-kinematics=" + str(tmp_path / "live2" / "calibration.yaml")], machine).live
    _, expected = left_um(moved, held.file)
    assert abs(left[3] - expected) < 0.5


FAULTS = {
    "sphere bumped": ({"bumped": 50, "bumped-sphere": 1, "bump-0": 0.04, "bump-1": -0.03}, 10.0),
    "wrong length": ({"length": 0.7}, 1.5),
    "backlash of X": ({"backlash-0": 0.012}, 1.5),
    "backlash of C": ({"backlash-4": 0.004}, 6.0),
}
"""Parameters of the component (the length is added), and the bar of the error that its calibration leaves, µm RMS."""


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named_and_makes_no_machine_worse(
    machine: twin.Machine, physical: Physical, tmp_path: Path, name: str
) -> None:
    fault, bar = FAULTS[name]
    program = planned(tmp_path, "fault", "--minutes", 30)
    folder = room(tmp_path, program)
    faults = fault | ({"length": physical.probe["length"] + fault["length"]} if "length" in fault else {})
    ran = execute(folder, machine, physical, [["home"], ["program", program.name]], faults=faults)
    assert not ran.failed, f"{ran.failed}\n{ran.log}"
    said = converted(tmp_path, folder / "FAULT_LOG.csv", "measured.csv")
    said += " " + command(tmp_path, "identify", "measured.csv", "-o", "mine.yaml", "--only", "E_*0*")
    said += " " + command(tmp_path, "diagnose", "measured.csv", "-c", "mine.yaml")
    before, after = left_um(physical, tmp_path / "mine.yaml")
    assert before > 8.0 and after < bar, said
    if name == "backlash of X":
        size = re.findall(r"spheres are ([\d.]+) ± .* smaller along X than along Y: backlash of X", said)
        assert abs(float(size[0]) - 12.0) < 2.0
        assert "CONSISTENT" in said
    elif name == "backlash of C":
        size = re.findall(r"C has ([\d.]+) µrad of backlash", said)
        assert abs(float(size[0]) - np.radians(0.004) * 1e6) < 12.0
        assert "Backlash of C (reversal C, machine)" in said and "RESIDUALS LARGER THAN THE STATED UNCERTAINTY" in said
    elif name == "wrong length":
        length = re.findall(r"tip of probe: \S+ \S+ -([\d.]+) mm from the spindle nose", said)
        assert float(length[0]) == pytest.approx(faults["length"], abs=0.1) and "CONSISTENT" in said
    else:
        assert "Target sphere 2 displaced within round 1" in said and "from line 15 of the table on" in said
        size = re.findall(r"shift x ([\d.]+) ± .* shift y −([\d.]+) ±", said)
        assert np.allclose([float(value) for value in size[0]], [40.0, 30.0], atol=3.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["spindle", "environment", "axes"])
def test_programs_of_drift_tests_run_to_their_end(
    machine: twin.Machine, physical: Physical, tmp_path: Path, name: str
) -> None:
    """Dwells are a thousandth as long; M0, where the operator exchanges tool and probe, is continued."""
    instrument = "probe" if name == "spindle" else "r-test"
    words = {"spindle": ["--highest-rpm", 6000, "--minutes", 100, "--clearance", 3], "axes": ["--axis", "X"]}
    place = ",".join(f"{value:g}" for value in SPHERES[0])
    places = ["--spheres", place, *(["-75,130,90"] if name == "axes" else [])]
    plan = ["plan", "--drift", name, "--instrument", instrument, "-o", "d.csv", "--program", "d.ngc", "--quiet"]
    command(tmp_path, *plan, "--tool-length", LENGTH, *places, *words.get(name, []))
    program = tmp_path / "d.ngc"
    text = re.sub(r"(?m)^G4 P([\d.]+)", lambda found: f"G4 P{float(found[1]) / 1000.0:.4f}", program.read_text())
    if name == "axes":
        # Between the readings the axis moves for minutes: the first three are enough.
        text = text[: text.index("(reading 4 ")] + "G53 G0 Z0\nM2\n"
    program.write_text(text)
    folder = room(tmp_path, program)
    end = [["mdi", "G53 G0 X250"], ["hal", ["getp", "joint.0.motor-pos-cmd"]]]
    # The nest of an R-test stands where the sphere of a probe would.
    faults = {} if instrument == "probe" else {"ball-radius": -1000.0}
    ran = execute(folder, machine, physical, [["home"], ["program", program.name], *end], faults=faults)
    assert not ran.failed and not ran.said, f"{ran.failed}\n{ran.said}\n{ran.log}"
    assert ran.results("hal") == ["0"]
    if name == "spindle":
        assert text.count("\nM0\n") > 5 and text.count("G38.2") > 40
        converted(tmp_path, folder / "D_LOG.csv", "measured.csv")
        found, _ = centres(machine, tmp_path / "measured.csv")
        assert 5 * len(found) == text.count("G38.2")
        assert np.ptp(found[:, :3], axis=0).max() < 0.01


NOT_MET = 3
"""Status of `plan` where some errors cannot be determined; here those that a motion of the workpiece or the tool imitates."""


@pytest.mark.slow
def test_tracker_points_at_standstill_correct_a_machine_with_all_curves(machine: twin.Machine, tmp_path: Path) -> None:
    """The tracker's plan is executed, all errors are identified and corrected by the module."""
    plan = tmp_path / "plan.csv"
    command(tmp_path, "plan", "-o", plan, "--tool-length", LENGTH, "--quiet", status=NOT_MET)
    rows = stops(plan)
    physical = replace(Physical.drawn(3, curves_um=3.0), reflectors=reflectors(rows))
    places, run, again = poses(), tmp_path / "run", tmp_path / "again"
    run.mkdir()
    again.mkdir()
    (run / "points.ngc").write_text(tracker_program(rows, physical, LENGTH))
    with physical.installed(tmp_path / "component"):
        ran = execute(run, machine, physical, [["home"], ["program", "points.ngc"], *visits(places)])
        assert not ran.failed, f"{ran.failed}\n{ran.log}"
        before = remaining_um(places, tips(ran, len(places)))
        write_tracked(tmp_path / "measured.csv", rows, np.loadtxt(run / "points.csv", delimiter=","), seed=0)
        command(tmp_path, "identify", "measured.csv", "-o", "mine.yaml")
        to = ["control", "--to", "linuxcnc-kinematics", "-o", "live", "-c", "mine.yaml", "--tool-length", LENGTH]
        assert "were not identified" in command(tmp_path, *to, status=2)
        command(tmp_path, *to, "--force")
        with module(tmp_path / "live") as live:
            ran = execute(again, machine, physical, [["home"], *ON, *visits(places)], live=live)
        assert not ran.failed, f"{ran.failed}\n{ran.log}"
    after = remaining_um(places, tips(ran, len(places)))
    print(f"before {rms(before):.2f} {before.max():.2f}, after {rms(after):.2f} {after.max():.2f} µm")
    assert rms(before) > 15.0 and rms(after) < 3.5 and after.max() < 5.3
    # From the base the correction itself is seen: such readings are refused.
    on = ["--control", "linuxcnc-kinematics=live/calibration.yaml"]
    assert "reading from the base" in command(tmp_path, "identify", "measured.csv", "-o", "no.yaml", *on, status=2)


# The way to the first pose is not checked: at home the tip is clear of the sphere.
SPHERE_OF = {
    "trunnion": (50.0, 0.0, 60.0),
    "head-table": (60.0, -40.0, 60.0),
    "nutating head and table": (60.0, -40.0, 60.0),
    "head-head": (400.0, 300.0, 60.0),
    "four axes": (150.0, 120.0, 220.0),
}


@pytest.mark.slow  # half a minute each
@pytest.mark.parametrize("name", SPHERE_OF)
def test_measuring_programs_of_every_kind_run_to_their_end(name: str, machine: twin.Machine, tmp_path: Path) -> None:
    """The centres in the log are where the tip of the machine, in plain numpy, is at the true sphere; no rapid touches it."""
    kind, place = KINDS[name](), SPHERE_OF[name]
    other = kind.machine(tmp_path)
    physical = Physical.of_kind(kind, other.names, place)
    plan = ["plan", "--instrument", "probe", "-m", kind.bundled or "kind.yaml", "-o", "p.csv", "--program", "p.ngc"]
    plan += ["--tool-length", str(LENGTH), "--clearance", "3", "--minutes", "8", "--quiet", "--spheres", joined(place)]
    command(tmp_path, *plan)
    folder = room(tmp_path, tmp_path / "p.ngc")
    with physical.installed(tmp_path / "component"):
        ran = execute(folder, other, physical, [["home"], ["program", "p.ngc"]])
    assert not ran.failed and not ran.said, f"{ran.failed}\n{ran.said}\n{ran.log}"
    converted(tmp_path, folder / "P_LOG.csv", "m.csv", "-m", kind.bundled or "kind.yaml")
    found, _ = centres(other, tmp_path / "m.csv")
    assert len(found) >= 3 and 5 * len(found) == (tmp_path / "p.ngc").read_text().count("G38.2")
    off = np.linalg.norm(kind.tip(other.names, found, (0.0, 0.0, LENGTH)) - physical.places[0], axis=1)
    print(f"{name}: {len(found)} poses, the sphere off by {1e3 * off.max():.1f} µm at most")
    # Resolution 3.3 µm, noise, lobing; what is alike on all sides is along the tool.
    assert off.max() < 0.012 < 0.1 < np.linalg.norm(np.array(place) - physical.places[0])


LOGGED = """G21 G90 G17 G94
G10 L2 P1 X10 Y20 Z-5 R0
G54 G43.1 Z50
G53 G0 Z0
G53 G0 X400 Y225 B0 C0
G53 G0 Z-190
(PROBEOPEN probe.txt)
(LOGOPEN,own.txt)
G38.2 Z-260 F200
(LOG,#5061 #5062 #5063)
G53 G0 Z-190
G20 G38.2 Z-10 F8
(LOG,#5061 #5062 #5063)
G21
G53 G0 Z-190
G38.3 Z-236 F200
(LOG,#5061 #5062 #5063)
(PROBECLOSE)
(LOGCLOSE)
M2
"""
"""The sphere is touched from above in millimetres and in inches, behind an offset and a tool length; the last search ends before it."""


@pytest.mark.slow
def test_the_log_of_the_control_is_in_the_coordinates_and_units_of_the_program(
    machine: twin.Machine, physical: Physical, tmp_path: Path
) -> None:
    program = tmp_path / "log.ngc"
    program.write_text(LOGGED)
    folder = room(tmp_path, program)
    ran = execute(folder, machine, physical, [["home"], ["program", "log.ngc"]], faults={"noise": 0.0})
    assert not ran.failed, f"{ran.failed}\n{ran.log}"
    log, own = (np.loadtxt(folder / name) for name in ("probe.txt", "own.txt"))
    assert np.allclose(log[:, :3], own, atol=1e-6) and not log[:, 3:].any()
    # The machine: what the log says, and the offset and the length.
    touched = np.array([log[0], 25.4 * log[1]])[:, :3] + [10.0, 20.0, -5.0 + 50.0]
    for place in touched:
        away = physical.tip(np.array([*place, 0.0, 0.0])) - physical.places[0]
        assert np.linalg.norm(away) == pytest.approx(12.5 + 3.0 - physical.probe["pretravel"], abs=0.004)
    assert log[2, 2] == pytest.approx(-236.0, abs=0.001)
