"""Measuring sequences: one suite over all of them, their positions from an independent chain, and what they determine."""

from __future__ import annotations

import json
from dataclasses import FrozenInstanceError, replace
from pathlib import Path

import numpy as np
import pytest

from tests.linuxcnc.machines import KINDS
from tests.truth.reference import dmu50_pose
from twin import cli
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.instruments import INSTRUMENTS
from twin.measurement.table import Measurements
from twin.planning import SequencePlan, judge_sequence, measuring_sequence
from twin.planning.sequences.moves import SEQUENCES, sequence_named
from twin.planning.sequences.specification import SET_UPS, InstrumentSizes, MeasuringSequence

LENGTH = 120.0
PAIRS = [
    (sequence, name) for sequence in SEQUENCES for name in sequence.instruments if not sequence.name.startswith("ak")
]
every_pair = pytest.mark.parametrize(
    ("sequence", "instrument"), PAIRS, ids=[f"{sequence.name} {name}" for sequence, name in PAIRS]
)


def planned(
    machine: Machine, instrument: str, sequence: str | None = None, *, minutes: float = 40.0, clearance: float = 10.0
) -> SequencePlan:
    sizes = InstrumentSizes(LENGTH, clearance_mm=clearance)
    return measuring_sequence(machine, instrument, sequence, minutes=minutes, sizes=sizes)


def status(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        cli.main([str(argument) for argument in arguments])
    return int(stopped.value.code or 0)


@pytest.mark.parametrize("sequence", SEQUENCES, ids=lambda one: one.name)
def test_a_specification_is_complete_and_cannot_change(sequence: MeasuringSequence) -> None:
    assert sequence.title and sequence.source and sequence.limits
    assert sequence.instruments and set(sequence.instruments) <= set(SET_UPS)
    assert sequence.unverified or "ISO" not in sequence.source
    with pytest.raises(FrozenInstanceError):
        sequence.name = "another"  # type: ignore[misc]


def test_names_are_distinct_and_every_such_instrument_has_a_default() -> None:
    assert len({one.name for one in SEQUENCES}) == len(SEQUENCES)
    relative = {
        one.name
        for one in INSTRUMENTS
        if one.specification.rides_on[0] in ("tool", "work") and not one.specification.aligned
    }
    assert relative == set(SET_UPS)
    assert [sequence_named(None, name).name for name in SET_UPS] == ["best", "best", "circles"]


@pytest.mark.sample(2)  # of 8
@every_pair
def test_the_tool_is_at_the_part_on_the_table(
    dmu50: Machine, tmp_path: Path, sequence: MeasuringSequence, instrument: str
) -> None:
    """By a chain that shares no code with `twin`: the tip is at the sphere (the bar's length away), within the ranges."""
    made = planned(dmu50, instrument, sequence.name)
    made.save(tmp_path / "p.csv")
    table = Measurements.load(tmp_path / "p.csv", dmu50, plan=True)
    assert len(table) == len(made.table) > 5 and not table.set_aside
    ((place),) = made.task.places_mm.values()
    q = table.positions
    away = np.array(
        [dmu50_pose([*row[:3], *np.radians(row[3:])], {}, LENGTH)[:3, 3] - np.array(place) for row in q]  # type: ignore[arg-type]
    )
    distance = np.linalg.norm(away, axis=1)
    assert distance == pytest.approx(made.task.sizes.bar_mm if instrument == "ball-bar" else 0.0, abs=1.5e-3)
    low, high = np.array([axis.domain for axis in dmu50.axes[:4]]).T
    margin = (25.0 + 6.0) / 2.0 + 10.0 if instrument == "probe" else 0.0
    assert np.all(q[:, :3] >= low[:3] + margin) and np.all(q[:, :3] <= high[:3] - margin)
    assert np.all(q[:, 3] >= low[3]) and np.all(q[:, 3] <= high[3])
    assert np.all(np.diff(table.time_s) > 0.0) or (np.all(np.diff(table.time_s) >= 0.0) and instrument == "ball-bar")
    # The approach is the sign of the last motion.
    step = np.diff(q, axis=0)
    moving = (step != 0.0) & (table.approach[1:] != 0.0)
    assert np.array_equal(np.sign(step)[moving], table.approach[1:][moving])
    if instrument == "probe":
        assert not table.approach[:, :3].any()


@pytest.mark.sample(2)  # of 8
@every_pair
def test_the_plan_alone_gives_the_same_prediction(
    dmu50: Machine, tmp_path: Path, sequence: MeasuringSequence, instrument: str
) -> None:
    made = planned(dmu50, instrument, sequence.name)
    made.save(tmp_path / "p.csv")
    judged = judge_sequence(Measurements.load(tmp_path / "p.csv", dmu50, plan=True), dmu50)
    assert judged.lines() == made.expected.lines()
    known = list(judged.by_knowledge.values())
    # Known parts never take anything away.
    assert known[0].determined <= known[1].determined <= known[2].determined <= len(known[2].u)
    for name, u in known[0].u.items():
        if np.isfinite(u):
            assert known[1].u[name] <= u * 1.0001 and known[2].u[name] <= known[1].u[name] * 1.0001
    text = made.to_text()
    for lost in known[0].lost:
        assert lost in text
    assert (made.best is None) == (sequence.name in ("best", "circles"))


@pytest.mark.slow
def test_what_a_sphere_at_an_unknown_place_cannot_show(dmu50: Machine) -> None:
    """The common scale needs a known distance; the tip's length cannot be separated from the swivel axis."""
    lost = planned(dmu50, "probe").expected.unknown.lost
    assert "the common scale of X, Y and Z" in lost and "E_X0B" in lost
    circles = planned(dmu50, "ball-bar").expected.unknown
    assert circles.determined == 6 and not circles.lost


@pytest.mark.slow
def test_the_design_is_better_than_the_standard_sequences_in_the_same_time(dmu50: Machine) -> None:
    for instrument, name in (("probe", "turns"), ("r-test", "bk4")):  # which move the same axes
        made = planned(dmu50, instrument, name)
        assert made.best is not None
        rival, own = made.best.unknown, made.expected.unknown
        shared = [key for key, u in own.u.items() if np.isfinite(u) and np.isfinite(rival.u[key])]
        ratio = [rival.u[key] / own.u[key] for key in shared]
        assert shared and np.sqrt(np.mean(np.square(ratio))) < 0.9, (name, ratio)


@pytest.mark.slow
def test_more_time_gives_smaller_uncertainty(dmu50: Machine) -> None:
    short, long = planned(dmu50, "probe", minutes=25.0), planned(dmu50, "probe", minutes=45.0)
    assert short.minutes <= 25.0 and 40.0 < long.minutes <= 45.0 and len(long.table) > 1.8 * len(short.table)
    names = [name for name, u in short.expected.unknown.u.items() if np.isfinite(u)]
    assert all(long.expected.unknown.u[name] < short.expected.unknown.u[name] for name in names)


@pytest.mark.slow
def test_all_spheres_are_measured_or_the_plan_says_which_are_not(dmu50: Machine) -> None:
    """Half an hour is enough for three spheres, ten minutes for setting up two of them with six poses."""
    places = {"a": (150.0, 0.0, 60.0), "b": (-80.0, 110.0, 40.0), "c": (-60.0, -120.0, 80.0)}
    sizes = InstrumentSizes(LENGTH)
    made = {m: measuring_sequence(dmu50, "probe", minutes=m, places_mm=places, sizes=sizes) for m in (30.0, 10.0)}
    assert set(made[30.0].table.target) == {"a", "b", "c"} and "NOT MEASURED" not in made[30.0].to_text()
    assert set(made[10.0].table.target) == {"a", "b"} and "NOT MEASURED: c" in made[10.0].to_text()
    assert made[10.0].minutes <= 10.0


def test_the_kit_states_the_time_of_a_contact(dmu50: Machine) -> None:
    """Five contacts a pose: half the time of one saves 15 s a pose, whatever the axes travel."""
    made = measuring_sequence(dmu50, "probe", "turns", sizes=InstrumentSizes(tool_length_mm=120.0))
    kit = replace(made.task.kit, seconds=made.task.kit.seconds.model_copy(update={"contact": 3.0}))
    quick = replace(made, task=replace(made.task, kit=kit))
    assert made.minutes - quick.minutes == pytest.approx(len(made.table) * 15.0 / 60.0)


@pytest.mark.slow
def test_points_out_of_reach_are_dropped_with_their_number(dmu50: Machine) -> None:
    made = planned(dmu50, "probe", "turns")
    assert len(made.table) + sum(made.dropped.values()) == 28
    assert any("Z beyond its range" in text for text in made.notices()) and made.dropped["Z beyond its range"] > 0
    assert len(planned(dmu50, "probe", "turns", clearance=30.0).table) < len(made.table)


@pytest.mark.parametrize(
    ("instrument", "sequence", "what"),
    [
        ("probe", "bk1", "no such sequence for instrument probe"),
        ("probe", "turn", "no such sequence"),
        ("tracker", None, "no such sequence for instrument tracker"),
        ("r-test", "ak1", "both rotary axes on the spindle side"),
        ("r-test", "bk3", "BK3 of ISO 10791-6 is not included: no public description says which axes"),
        ("ball-bar", "ck2", "CK2 of ISO 10791-6 is not included.*expected one of circles"),
    ],
)
def test_refusals(dmu50: Machine, instrument: str, sequence: str | None, what: str) -> None:
    with pytest.raises(InputError, match=what):
        planned(dmu50, instrument, sequence)


@pytest.mark.parametrize(
    ("minutes", "place", "what"),
    [
        (5.0, (150.0, 0.0, 60.0), "time budget is too short"),
        (60.0, (150.0, 0.0, 1000.0), "too few poses are reached"),
        (0.0, (150.0, 0.0, 60.0), "impossible time budget"),
        (60.0, (np.nan, 0.0, 60.0), "not finite"),
    ],
)
def test_impossible_numbers(dmu50: Machine, minutes: float, place: tuple[float, float, float], what: str) -> None:
    with pytest.raises(InputError, match=what):
        measuring_sequence(dmu50, "probe", minutes=minutes, places_mm={"sphere": place})


@pytest.mark.sample(1)  # of 3
@pytest.mark.parametrize("name", ["trunnion_ac", "xyzbc_trunnion", "tests/real/head_head.yaml"])
def test_other_machines(name: str) -> None:
    machine = Machine.load(name if "/" not in name else Path(__file__).parents[2] / name)
    made = planned(machine, "probe", "turns")
    assert made.expected.unknown.determined >= 10
    if "head" in name:
        ak = planned(machine, "r-test", "ak1")
        assert len(ak.table) > 20
        with pytest.raises(InputError, match="table side"):
            planned(machine, "r-test", "bk1")


CONSTANTS = """schema: twin.calibration/1
machine: DMU 50 eVolution
source: a test
datum: mean lines
curves:
  E_XX: {unit: um, domain: [0, 500], basis: power, coefficients: [0, 6]}
  E_YY: {unit: um, domain: [0, 450], basis: power, coefficients: [0, -4]}
  E_ZZ: {unit: um, domain: [-400, 0], basis: power, coefficients: [0, 5]}
squareness: {E_C0Y: -40, E_A0Z: 25, E_B0Z: 30}
location: {E_X0B: -8, E_Y0B: 12, E_A0B: 63, E_B0B: -8, E_X0C: 6, E_Y0C: -15, E_A0C: 22, E_B0C: -35}
"""


@pytest.mark.slow
@pytest.mark.parametrize("instrument", ["probe", "r-test"])
def test_from_the_sequence_to_the_constants(tmp_path: Path, instrument: str) -> None:
    """plan, simulate, identify: the constant errors that are determined come back within their uncertainty, which is that predicted."""
    (tmp_path / "truth.yaml").write_text(CONSTANTS)
    plan, measured, found, report = (tmp_path / name for name in ("p.csv", "m.csv", "c.yaml", "p.json"))
    arguments = ("plan", "--instrument", instrument, "-o", plan, "--tool-length", 120, "--minutes", 45)
    assert status(*arguments, "--spheres", "150,0,60", "-90,120,100", "--json", report) == 0
    assert status("simulate", plan, "-o", measured, "--calibration", tmp_path / "truth.yaml", "--seed", 4) == 0
    only = ("E_*0*", "E_XX", "E_YY", "E_ZZ")
    assert status("identify", measured, "-o", found, "--only", *only, "--json", tmp_path / "i.json") == 0
    errors = {row["name"]: row for row in json.loads((tmp_path / "i.json").read_text())["errors"]}
    predicted = json.loads(report.read_text())["constant_errors"][0]["errors"]
    truth = dict(E_C0Y=-40, E_A0Z=25, E_B0Z=30, E_A0B=63, E_B0B=-8, E_X0C=6, E_A0C=22, E_B0C=-35)
    u = {row["name"]: row["u"] for row in predicted if row["u"] is not None and row["name"] in truth}
    assert len(u) >= 7
    for name, standard in u.items():
        assert abs(errors[name]["value"] - truth[name]) < 3.5 * standard + 0.01, name
        # The estimate also has curves of degree 12 as unknowns, which the prediction leaves out.
        assert 0.99 < errors[name]["u"] / standard < 3.0, name


def test_fewer_readings_than_unknowns(tmp_path: Path) -> None:
    """A head with two axes, four poses in reach of one sphere: most errors are not determined, and the plan says so."""
    machine = KINDS["head-head"]().machine(tmp_path)
    sizes = InstrumentSizes(tool_length_mm=120.0)
    plan = measuring_sequence(machine, "probe", "turns", places_mm={"a": (50.0, 0.0, 60.0)}, sizes=sizes)
    assert len(plan.table) == 4 and "6 of 14 determined" in plan.to_text()
