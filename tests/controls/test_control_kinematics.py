"""Kinematics of a control made from a calibration: read back, against independent controls and machines, and not corrected twice.

Controls are those of `tests.truth.rotary_table`, the DMU 50 that of `tests.truth.machine`: of `twin` only the files are used.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.truth.machine import TruthMachine
from tests.truth.rotary_table import chain_commands, chain_file, chain_of, pins_of, trt_joints
from twin import cli
from twin._common.errors import InputError
from twin.compensation import Options, compensate
from twin.compensation.tables.axis_tables import make_kinematics, real_geometry
from twin.controls.kinematics import kinematics_formats, kinematics_named
from twin.controls.kinematics.format import linear_shift, table_geometry
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.numerics.covariance import Covariance
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import volume

TOOL = 120.0
URDF = Path(__file__).parents[2] / "urdf"
COMPLETE = ("siemens-chain", "siemens-trafo5", "heidenhain-kinematics")
MACHINES = {
    name: Machine.load(path)
    for name, path in (("dmu50", "dmu50"), ("ac", URDF / "trunnion_ac.yaml"), ("bc", URDF / "xyzbc_trunnion.yaml"))
}
POSSIBLE = [
    (name, form.name)
    for name in MACHINES
    for form in kinematics_formats()
    if (name, form.name) != ("dmu50", "linuxcnc-trt")
]


def main(arguments: list[str]) -> int:
    with pytest.raises(SystemExit) as end:
        cli.main(arguments)
    return int(end.value.code or 0)


def located(machine: Machine, numbers: dict[str, float]) -> Calibration:
    return replace(Calibration.zero(machine), source="drawn", location=MappingProxyType(numbers))


def drawn(machine: Machine, seed: int = 1, size: float = 60.0) -> Calibration:
    rng = np.random.default_rng(seed)
    return located(machine, {name: float(rng.normal(0, size)) for name in machine.location_names})


def positions(machine: Machine, count: int = 200) -> np.ndarray:
    rng = np.random.default_rng(8)
    return np.stack([rng.uniform(*axis.domain, count) for axis in machine.axes], axis=1)


@pytest.mark.sample(4)  # of 14
@pytest.mark.parametrize(("name", "kind"), POSSIBLE)
@settings(max_examples=3, deadline=None)
@given(data=st.data())
def test_read_back_within_a_tenth_of_a_micrometre(name: str, kind: str, data: st.DataObject) -> None:
    machine = MACHINES[name]
    sizes = st.floats(-300.0, 300.0)
    numbers = {one: data.draw(sizes) for one in machine.location_names}
    numbers[machine.location_names[0]] += 400.0
    made = make_kinematics(located(machine, numbers), kind, TOOL)
    assert made.round_trip_um <= 0.1
    assert not made.unmet
    if kind in COMPLETE:
        assert made.left_max_um < 0.1
    assert made.left_rms_um <= made.displaced_rms_um


@pytest.mark.parametrize(("name", "tilting"), [("ac", "A"), ("bc", "B")])
def test_linuxcnc_makes_the_same_joints(name: str, tilting: str) -> None:
    machine = MACHINES[name]
    made = make_kinematics(drawn(machine), "linuxcnc-trt", TOOL)
    form = kinematics_named("linuxcnc-trt")
    new, old = (pins_of(text) for text in (made.text, form.write(form.nominal(machine), machine)))
    q = positions(machine)
    expected = linear_shift(machine, made.geometry, q, TOOL)
    for row, shift in zip(q, expected, strict=True):
        # The tip on the table at zero, from the nominal joints, found by inverting the independent formula with three unit steps.
        at = trt_joints(old, tilting, np.zeros(3), *row[3:], TOOL)
        by = np.stack([trt_joints(old, tilting, one, *row[3:], TOOL) - at for one in np.eye(3)], axis=1)
        tip = np.linalg.solve(by, row[:3] - at)
        moved = trt_joints(new, tilting, tip, *row[3:], TOOL) - row[:3]
        assert moved * 1e3 == pytest.approx(shift, abs=2e-6)


def test_nominal_kinematics_of_linuxcnc_are_those_of_the_machine() -> None:
    machine = MACHINES["ac"]
    form = kinematics_named("linuxcnc-trt")
    pins = pins_of(form.write(form.nominal(machine), machine))
    nominal = Kinematics(machine, Calibration.zero(machine), tool_length_mm=TOOL)
    centre = table_geometry(machine).points[1]
    q = positions(machine, 50)
    for row, point in zip(q, nominal.forward(q).point_mm, strict=True):
        assert trt_joints(pins, "A", point + centre, *row[3:], TOOL) == pytest.approx(row[:3], abs=1e-6)


def test_linuxcnc_leaves_the_directions_and_holds_the_positions() -> None:
    machine = MACHINES["ac"]
    whole = drawn(machine)
    alone = located(machine, {name: value for name, value in whole.location.items() if name[2] in "XYZ"})
    assert make_kinematics(alone, "linuxcnc-trt", TOOL).left_max_um < 0.01
    made = make_kinematics(whole, "linuxcnc-trt", TOOL)
    assert made.left_rms_um > 5.0
    # No other values of its parameters leave less: a change of any of them by 5 µm increases the sum of squares.
    form = made.form
    places = volume(machine)
    goal = linear_shift(machine, real_geometry(whole), places, TOOL)
    best = float(np.sum((goal - linear_shift(machine, made.geometry, places, TOOL)) ** 2))
    pins = pins_of(made.text)
    values = {name: pins[name] for name in form.nominal(machine)}
    for name in values:
        for step in (0.005, -0.005):
            other = form.geometry(values | {name: values[name] + step}, machine)
            assert float(np.sum((goal - linear_shift(machine, other, places, TOOL)) ** 2)) > best - 1e-3


def test_a_dmu50_under_its_own_chain_reaches_the_nominal_pose(tmp_path: Path) -> None:
    machine = MACHINES["dmu50"]
    errors = drawn(machine)
    errors.save(tmp_path / "c.yaml")
    truth = TruthMachine(tmp_path / "c.yaml", TOOL)
    chain = chain_of(make_kinematics(errors, "siemens-chain", TOOL).text)
    worst = []
    for q in positions(machine, 60):
        tip = truth.pose(q, real=False)[:3, 3]
        commands = np.array([*chain_commands(chain, "BC", tip, q[3:], TOOL), *q[3:]])
        worst.append(np.linalg.norm(truth.pose(commands)[:3, 3] - tip) * 1e3)
    assert max(worst) < 0.1


def write_chain(folder: Path, *more: str) -> None:
    """Write the kinematics for a SINUMERIK from ``c.yaml`` into the folder ``k``."""
    files = ["-o", str(folder / "k"), "-c", str(folder / "c.yaml")]
    assert main(["control", "--kinematics", "siemens-chain", *files, "--quiet", *more]) == 0


def test_a_program_is_not_corrected_twice(tmp_path: Path) -> None:
    machine = MACHINES["dmu50"]
    drawn(machine).save(tmp_path / "c.yaml")
    write_chain(tmp_path, "--tool-length", "120")
    truth, chain = TruthMachine(tmp_path / "c.yaml", TOOL), chain_file(tmp_path / "k")
    rng = np.random.default_rng(4)
    words = np.column_stack(
        [rng.uniform(-60, 60, (12, 2)), rng.uniform(40, 80, 12), rng.uniform(0, 60, 12), rng.uniform(0, 90, 12)]
    ).round(3)
    lines = [" ".join(f"{name}{value:.3f}" for name, value in zip("XYZBC", row, strict=True)) for row in words]
    program = tmp_path / "p.nc"
    program.write_text("G90 G21\n" + "".join(f"G1 {line} F1000\n" for line in lines) + "M30\n")

    def off(calibration: Path) -> float:
        result = compensate(
            program,
            machine,
            Calibration.load(calibration, machine),
            options=Options(tcp=True, tool_length_mm=TOOL, tolerance_mm=0.1),
        )
        out = [line for line in result.text.splitlines() if line.startswith("G1")]
        found = []
        for line, row in zip(out, words, strict=True):
            new = np.array([float(word[1:]) for word in line.split()[1:6]])
            commands = np.array([*chain_commands(chain, "BC", new[:3], new[3:], TOOL), *new[3:]])
            reached = truth.pose(commands)[:3, 3]
            assert np.abs(row - new).max() < 1.0
            found.append(np.linalg.norm(reached - row[:3]) * 1e3)
        return max(found)

    assert off(tmp_path / "k" / "calibration.yaml") < 2.0
    assert off(tmp_path / "c.yaml") > 20.0


def test_in_axis_coordinates_the_kinematics_do_not_count(tmp_path: Path) -> None:
    machine = MACHINES["dmu50"]
    drawn(machine).save(tmp_path / "c.yaml")
    write_chain(tmp_path)
    held, plain = (
        Calibration.load(path, machine) for path in (tmp_path / "k" / "calibration.yaml", tmp_path / "c.yaml")
    )
    program = tmp_path / "p.nc"
    program.write_text("G90 G21\nG1 X250 Y220 Z-100 B10 C20 F1000\nG1 X260 Y230 Z-120 B20 C40\nM30\n")
    texts = [compensate(program, machine, one).text for one in (held, plain)]
    assert texts[0] == texts[1]
    program.write_text("G90 G21\nG1 X250 Y220 Z-100 B10 C20 F1000\nG43.4 H1\nG1 X0 Y0 Z50 B20 C40\nM30\n")
    with pytest.raises(InputError, match="tool centre point mode only"):
        compensate(program, machine, held)
    compensate(program, machine, plain)


def test_the_account_of_all_stages(tmp_path: Path) -> None:
    machine = MACHINES["dmu50"]
    names = machine.location_names
    errors = replace(
        drawn(machine),
        squareness=MappingProxyType({"E_C0Y": 40.0}),
        joint=Covariance(names, np.diag(np.full(len(names), 4.0))),
    )
    errors.save(tmp_path / "c.yaml")
    arguments = [
        "control",
        "--kinematics",
        "siemens-chain",
        "--to",
        "siemens",
        "-o",
        str(tmp_path / "k"),
        "-c",
        str(tmp_path / "c.yaml"),
    ]
    assert main([*arguments, "--tool-length", "120", "--json", str(tmp_path / "a.json"), "--quiet"]) == 0
    found = json.loads((tmp_path / "a.json").read_text())
    stages = found["kinematics"]["error_at_tool"]
    truth, chain = TruthMachine(tmp_path / "c.yaml", TOOL), chain_file(tmp_path / "k")
    off: dict[str, list[float]] = {"before": [], "with_kinematics": []}
    for q in positions(machine, 400):
        tip = truth.pose(q, real=False)[:3, 3]
        commands = np.array([*chain_commands(chain, "BC", tip, q[3:], TOOL), *q[3:]])
        for name, there in (("before", q), ("with_kinematics", commands)):
            off[name].append(float(np.linalg.norm(truth.pose(there)[:3, 3] - tip)) * 1e3)
    for name, sizes in off.items():
        assert stages[name]["rms_um"] == pytest.approx(np.sqrt(np.mean(np.square(sizes))), rel=0.05)
    assert stages["with_kinematics_and_tables"]["rms_um"] < 0.2
    assert stages["with_program"]["rms_um"] < 0.6
    # U: locations with 2 µm and 2 µrad each; it is the same in all stages.
    assert 2.0 < stages["uncertainty"]["rms_um"] < 30.0
    assert stages["before"]["expected_rms_um"] > stages["before"]["rms_um"]
    text = (tmp_path / "k" / "README.txt").read_text()
    assert "with the kinematics and the tables" in text
    assert "NOT CHECKED" in text
    loaded = Calibration.load(tmp_path / "k" / "calibration.yaml", machine)
    assert loaded.control is not None
    assert [one.format for one in loaded.control.entries] == ["siemens", "siemens-chain"]
    assert [len(one.corrections) for one in (loaded, loaded.with_transformation())] == [1, 4]


def test_tables_made_later_keep_the_kinematics(tmp_path: Path) -> None:
    machine = MACHINES["dmu50"]
    errors = replace(drawn(machine), squareness=MappingProxyType({"E_C0Y": 40.0}))
    errors.save(tmp_path / "c.yaml")
    held, tables = tmp_path / "k", tmp_path / "t"
    assert main(["control", "--kinematics", "siemens-chain", "-o", str(held), "-c", str(tmp_path / "c.yaml")]) == 0
    assert main(["control", "--to", "siemens", "-o", str(tables), "-c", str(held / "calibration.yaml")]) == 0
    again = tmp_path / "again"
    assert (
        main(["control", "--kinematics", "siemens-trafo5", "-o", str(again), "-c", str(tables / "calibration.yaml")])
        == 0
    )
    for folder, kinematics in ((tables, "siemens-chain"), (again, "siemens-trafo5")):
        control = Calibration.load(folder / "calibration.yaml", machine).control
        assert control is not None
        assert [one.format for one in control.entries] == ["siemens", kinematics]


def test_read_and_compare(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = MACHINES["dmu50"]
    drawn(machine).save(tmp_path / "c.yaml")
    for kind in COMPLETE:
        folder = tmp_path / kind
        assert (
            main(["control", "--kinematics", kind, "-o", str(folder), "-c", str(tmp_path / "c.yaml"), "--quiet"]) == 0
        )
        file = folder / kinematics_named(kind).file
        again = [
            "control",
            "--read",
            str(file),
            "--format",
            kind,
            "-c",
            str(tmp_path / "c.yaml"),
            "--json",
            str(tmp_path / "r.json"),
        ]
        assert main(again) == 0
        assert json.loads((tmp_path / "r.json").read_text())["differs_max_um"] < 0.1
        capsys.readouterr()


def test_refusals(tmp_path: Path) -> None:
    machine = MACHINES["dmu50"]
    with pytest.raises(InputError, match="xyzac-trt needs A about X"):
        make_kinematics(drawn(machine), "linuxcnc-trt")
    with pytest.raises(InputError, match="no location errors"):
        make_kinematics(Calibration.zero(machine), "siemens-chain")
    drawn(machine).save(tmp_path / "c.yaml")
    arguments = ["control", "--kinematics", "siemens-chain", "-o", str(tmp_path / "k"), "-c", str(tmp_path / "c.yaml")]
    assert main([*arguments, "--to", "isg"]) == 2
    assert not (tmp_path / "k").exists()
    assert main([*arguments, "--quiet"]) == 0
    file = tmp_path / "k" / "kinchain.mpf"
    file.write_text(file.read_text() + "; changed\n")
    with pytest.raises(InputError, match="not the control table"):
        Calibration.load(tmp_path / "k" / "calibration.yaml", machine)


@pytest.mark.parametrize(("name", "kind"), POSSIBLE)
def test_a_damaged_file_is_refused(name: str, kind: str) -> None:
    machine = MACHINES[name]
    form = kinematics_named(kind)
    text = form.write(form.nominal(machine), machine)
    with pytest.raises(InputError):
        form.read_back("", machine)
    lines = text.splitlines()
    numbered = next(
        i
        for i, line in enumerate(lines)
        if any(key in line for key in ("x-rot-point", "BASE_TOOL_1[0]", "OFF_DIR[1,0]", "Trans", "N19700"))
    )
    for changed in (
        [*lines[:numbered], *lines[numbered + 1 :]],
        [*lines[:numbered], lines[numbered] + "x", *lines[numbered + 1 :]],
    ):
        if kind == "heidenhain-kinematics" and len(changed) < len(lines):
            continue  # a shift may be left out
        with pytest.raises(InputError):
            form.read_back("\n".join(changed), machine)
