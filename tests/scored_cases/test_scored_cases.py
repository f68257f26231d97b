"""Tests of the benchmark: truth machines, cases, scores, and continuation of an interrupted run."""

from __future__ import annotations

import csv
import json
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.scored_cases import __main__ as benchmark
from tests.scored_cases import known
from tests.scored_cases.builds import machines
from tests.scored_cases.carried import shares
from tests.scored_cases.cases import KINDS, MOST_CARRIED, OUTSIDE, Case, outside_of, truth_machines, write_case
from tests.scored_cases.gain import removed
from tests.scored_cases.methods import Command, Method, run_method
from tests.scored_cases.outside import HALF_WAVES, PATTERNS, Outside
from tests.scored_cases.plan import Plan, write_table
from tests.scored_cases.real import REAL_SETS, Answer
from tests.scored_cases.scores import in_words, is_wrong, probabilities, scores
from tests.scored_cases.table import markdown, reliability, rows, text
from tests.truth import hidden
from tests.truth.any_chain import Chain
from tests.truth.any_machine import Dmu50, TruthMachine, lagged
from tests.truth.hidden import Hidden
from twin.diagnosis import diagnose
from twin.machine.machine import Machine
from twin.measurement.observation import Observation
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import AxisLocation, Effect, ErrorMotion, Squareness
from twin.model.effects.entries import effect_named
from twin.numerics.covariance import Covariance
from twin.numerics.curves import POWER
from twin.tool.forward import Kinematics

NAMES = list(machines())


def few(name: str) -> TruthMachine:
    """Return a truth machine with a small plan."""
    machine = machines()[name]
    return Dmu50(stops=4, poses=15) if isinstance(machine, Dmu50) else replace(machine, stops=4, poses=15)


def targets(machine: TruthMachine) -> dict[str, tuple[str, tuple[float, float, float]]]:
    return dict(machine.targets) if isinstance(machine, Chain) else hidden.TARGETS


def base_points(machine: TruthMachine, plan: Plan, read: np.ndarray) -> np.ndarray:
    """Return (n, 3) positions of the targets in the base from readings, mm."""
    origin, turn = hidden.STATIONS["1"]
    x, y, z = turn
    angle = np.linalg.norm(turn)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) / angle
    rotation = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return read @ rotation.T + origin


def of_twin(effect: Hidden, machine: Machine, truth: TruthMachine) -> Effect:
    """Return the same effect as an object of `twin`."""
    axis = next((one for one in truth.axes if one.name == effect.where[3:]), None)
    if effect.effect == "squareness":
        return Squareness(effect.where, effect.numbers["angle"], machine.by_name[effect.where[4:]])
    if effect.effect == "axis_location":
        return AxisLocation(effect.where, effect.numbers["offset"])
    if axis is not None and effect.effect in ("positioning", "straightness", "angular_error_motion"):
        powers = tuple(effect.numbers[f"c{k}"] for k in range(len(effect.numbers)))
        return ErrorMotion(effect.where, POWER, (axis.low, axis.high), powers, wrapped=False)
    return effect_named(effect.effect, effect.where, effect.numbers, machine)


@pytest.mark.sample(1)  # of 4
@pytest.mark.parametrize("name", NAMES)
def test_a_truth_machine_is_what_twin_calculates(name: str, tmp_path: Path) -> None:
    """Compare effects of every common family, one at a time and all together; neither side is linearised."""
    truth = few(name)
    rng = np.random.default_rng(5)
    plan = truth.plan(rng)
    machine = Machine.load(truth.bundled or str(truth.write_machine(tmp_path)))
    data = Measurements.load(
        write_table(tmp_path / "measured.csv", plan, truth.readings(plan), truth.sigma_mm), machine
    )
    places = truth.places(plan)
    nominal = Calibration.default(machine)
    shared = [
        family
        for family in known.families(truth, plan)
        if known.origin(family) == "machine" and (name != "dmu50" or family != "gravity_compliance")
    ]
    hides = []
    for family in shared:
        where, numbers = known.FAMILIES[family]
        place = rng.choice(where(truth, plan))
        hides.append(known.scaled(Hidden(family, place, numbers(rng, truth, plan, place)), 20.0))
    for some in ([], *([one] for one in hides), hides):
        effects = [of_twin(one, machine, truth) for one in some]
        own = nominal.extended(effects, Covariance.none(), "a test") if effects else nominal
        points = Observation(machine).points_mm(own, data, places)
        off = base_points(truth, plan, truth.readings(plan, some)) - points
        # Rounding at 2 m, and the eighth decimal of temperatures: far below the tolerance of 1e-6 mm.
        assert np.abs(off).max() < 1e-6, [one.key for one in some]


@pytest.mark.parametrize("name", NAMES)
def test_a_truth_machine_is_not_linear(name: str) -> None:
    """Twice an angle of 1 mrad does not give exactly twice the displacement of a point at 100 mm: the difference is 0.1 µm."""
    truth = few(name)
    plan = truth.plan(np.random.default_rng(5))
    where = {"dmu50": "E_A0C", "trunnion": "E_A0C", "robot": "E_A0J2", "stage": "E_CX"}[name]
    numbers = {"offset": 1000.0} if where[3] == "0" else {"c0": 1000.0}
    once = Hidden("axis_location" if where[3] == "0" else "angular_error_motion", where, numbers)
    zero, one, two = (truth.readings(plan, some) for some in ([], [once], [known.scaled(once, 2.0)]))
    assert np.abs(two - 2.0 * one + zero).max() > 5e-5


def test_a_trunnion_stands_where_its_file_says() -> None:
    """Compare the tool point in the workpiece frame with `twin`'s kinematics over the whole range."""
    truth = machines()["trunnion"]
    assert isinstance(truth, Chain)
    at_tool = replace(truth, targets={"K": ("tool", (0.0, 0.0, 0.0)), "T": ("work", (0.0, 0.0, 0.0))})
    plan = at_tool.plan(np.random.default_rng(6))
    base = base_points(at_tool, plan, at_tool.readings(plan))
    tool, work = plan.carrier == "tool", plan.carrier == "work"
    poses = {tuple(q): i for i, q in enumerate(plan.q) if work[i]}
    kinematics = Kinematics(Machine.load("trunnion_ac"), None, tool_length_mm=0.0)
    pairs = [(i, poses[tuple(q)]) for i, q in enumerate(plan.q) if tool[i] and tuple(q) in poses]
    assert len(pairs) > 100
    first, second = (np.array(side) for side in zip(*pairs, strict=True))
    point = kinematics.forward(plan.q[first]).point_mm
    # The distance is independent of the frame.
    np.testing.assert_allclose(
        np.linalg.norm(point, axis=1), np.linalg.norm((base[first] - base[second]), axis=1), atol=1e-8
    )


def read_back(path: Path, machine: TruthMachine) -> Plan:
    """Return the plan of a written table."""
    with path.open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))

    def numbers(name: str) -> np.ndarray:
        return np.array([float(row[name]) for row in table])

    def words(name: str) -> np.ndarray:
        return np.array([row[name] for row in table])

    names = [name for name in table[0] if name.startswith("T_")]
    return Plan(
        machine.axes,
        np.stack([numbers(axis.column) for axis in machine.axes], axis=1),
        np.stack([numbers(f"approach_{axis.name}") for axis in machine.axes], axis=1),
        *(words(name) for name in ("target", "carrier", "station", "round")),
        time_s=numbers("time_s"),
        warm={name[2:-5]: numbers(name) for name in names},
        channels={"spindle_rpm": numbers("spindle_rpm")} if "spindle_rpm" in table[0] else {},
    )


def setup_columns(machine: TruthMachine, plan: Plan, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """Return (3n, k) changes of the readings by shifting every target by 0.1 mm, and by rigid motions of every station."""
    silent = machine.readings(plan)
    columns = []
    known_places = isinstance(machine, Chain) and machine.places_known
    for name, (side, place) in ({} if known_places else targets(machine)).items():
        for along in 0.1 * np.eye(3):
            there = {**targets(machine), name: (side, tuple(np.array(place) + along))}
            with monkeypatch.context() as patch:
                if isinstance(machine, Chain):
                    other: TruthMachine = replace(machine, targets=there)
                else:
                    other = machine
                    patch.setattr(hidden, "TARGETS", there)
                columns.append(other.readings(plan) - silent)
    for station in np.unique(plan.station):
        rows = (plan.station == station)[:, None]
        for along in np.eye(3):
            columns += [rows * along, rows * np.cross(along, silent - silent.mean(axis=0)) * 1e-3]
    return np.stack(columns, axis=2).reshape(3 * len(plan), -1)


@pytest.mark.sample(4)  # of 7
@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("dmu50", "two60"),
        ("trunnion", "outside-lost_motion"),
        ("trunnion", "known30"),
        ("robot", "mixed300"),
        ("stage", "outside-sawtooth"),
        ("stage", "further300"),
        ("stage", "nothing"),
    ],
)
def test_a_written_case_has_the_noncentrality_asked_for(
    name: str, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compute λ from the files alone: residual of the hidden change after fitting the set-up, in units of the noise."""
    machine = few(name)
    monkeypatch.setitem(truth_machines(), name, machine)
    folder = write_case(Case(name, kind, 1), tmp_path)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    plan = read_back(folder / "measured.csv", machine)
    setup = setup_columns(machine, plan, monkeypatch)
    silent = machine.readings(plan)
    hides: list[tuple[np.ndarray, float]] = []
    for one in truth["effects"]:
        numbers = {each["name"]: each["value"] for each in one["parameters"]}
        change = machine.readings(plan, [Hidden(one["effect"], one["where"], numbers)]) - silent
        hides.append((change, float(kind.lstrip("abcdefghijklmnopqrstuvwxyz"))))
        assert one["lambda"] == pytest.approx(hides[-1][1], rel=1e-3)
    if truth["outside"]:
        moved = Outside.from_dict(truth["outside"]).moved(machine, plan)
        hides.append((machine.readings(plan, moved=moved) - silent, OUTSIDE))
    assert len(hides) == {"two60": 2, "mixed300": 2, "nothing": 0}.get(kind, 1)
    for change, wanted in hides:
        scaled = change.reshape(-1) / machine.sigma_mm
        left = scaled - setup @ np.linalg.lstsq(setup, scaled, rcond=1e-9)[0]
        assert float(left @ left) == pytest.approx(wanted, rel=0.01)
    # The rest of the readings is noise of the stated standard deviation.
    with (folder / "measured.csv").open(encoding="utf-8", newline="") as file:
        read = np.array([[float(row[f"{c}_mm"]) for c in "xyz"] for row in csv.DictReader(file)])
    noise = (read - silent - sum(change for change, _ in hides)) / machine.sigma_mm
    # Four standard deviations of a mean square of n normals; the nonlinearity of two effects is far smaller.
    assert np.mean(noise**2) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / noise.size))


@pytest.mark.sample(12)  # of 32
@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("name", NAMES)
def test_a_pattern_outside_moves_one_side_by_its_formula(name: str, pattern: str) -> None:
    machine = few(name)
    rng = np.random.default_rng(7)
    plan = machine.plan(rng)
    for _ in range(3):
        drawn = outside_of(rng, machine, plan, pattern)
        moved = drawn.moved(machine, plan)
        assert np.all(moved[plan.carrier != drawn.side] == 0.0)
        assert set(drawn.columns) <= {*plan.columns(), *(f"approach_{axis.name}" for axis in machine.axes)}
        again = Outside.from_dict(json.loads(json.dumps(drawn.to_dict())))
        assert np.array_equal(again.moved(machine, plan), moved)
        own = [axis for axis in machine.axes if axis.column in drawn.columns]
        if pattern == "sawtooth":
            turning = [axis for axis in machine.axes if axis.side == drawn.side and not axis.linear]
            assert own[0].side != drawn.side or own[0] in turning[1:] or own[0].name == "C"
        if pattern == "lost_motion" and own[0].linear and drawn.columns[0] == f"approach_{own[0].name}":
            assert abs(machine.direction(own[0].name) @ drawn.direction) < 1e-12
        if pattern == "short_waves":
            assert all(HALF_WAVES[0] <= drawn.numbers[f"halves_{k}"] <= HALF_WAVES[1] for k in (1, 2))


@pytest.mark.sample(1)  # of 4
@pytest.mark.parametrize("name", NAMES)
def test_what_a_known_effect_can_carry(name: str) -> None:
    """An effect explains itself completely, and at most half of a pattern outside the catalogue."""
    machine = few(name)
    rng = np.random.default_rng(11)
    plan = machine.plan(rng)
    silent = machine.readings(plan)
    for family in known.families(machine, plan):
        effect = known.drawn(rng, machine, plan, family, 30.0)
        if effect is None or family in ("squareness", "table_load", "gravity_compliance"):
            continue
        change = machine.readings(plan, [effect]) - silent
        # Period and time constant lie between grid values.
        least = 0.8 if family == "pitch_error" else 0.98 if family == "thermal_drift" else 1.0 - 1e-4
        assert shares(machine, plan, change)[effect.key] > least
    # Half of all random jumps are mostly explained by a curve or a thermal growth and are rejected.
    for _ in range(6):
        drawn = outside_of(rng, machine, plan, "jump")
        found = shares(machine, plan, machine.readings(plan, moved=drawn.moved(machine, plan)) - silent)
        assert max(found.values()) <= MOST_CARRIED


def test_an_endless_axis_has_whole_waves() -> None:
    """A pattern has equal values at 0° and 360°, except for steps and sawteeth."""
    machine = few("trunnion")
    plan = machine.plan(np.random.default_rng(8))
    q = plan.q.copy()
    q[:, 4] = np.where(np.arange(len(q)) % 2 == 0, 1e-9, 360.0 - 1e-9)
    q[:, 0] = np.linspace(0.0, 600.0, len(q) // 2 + 1).repeat(2)[: len(q)]
    ends = replace(plan, q=q)
    numbers = {"halves_1": 5.3, "halves_2": 3.0, "phase_1": 0.3, "phase_2": 0.1}
    shape = PATTERNS["short_waves"].shape(ends, ("C_deg", "X_mm"), numbers)
    whole = len(q) // 2 * 2
    np.testing.assert_allclose(shape[:whole:2], shape[1:whole:2], atol=1e-6)


def test_a_lag_follows() -> None:
    """A step response is 1 − exp(−t/τ); a ramp is finally followed at a distance of τ."""
    time = np.arange(0.0, 4000.0, 2.0)
    step = lagged(time, np.ones(len(time)), 500.0, 0.0)
    np.testing.assert_allclose(step, 1.0 - np.exp(-time / 500.0), atol=1e-12)
    ramp = lagged(time, time, 500.0, 0.0)
    assert ramp[-1] == pytest.approx(time[-1] - 500.0, abs=0.5)  # e⁻⁸ · 500 s, and half a time step


def test_every_family_a_machine_can_have_is_drawn() -> None:
    """The cases of a kind cycle through the families."""
    machine = few("stage")
    plan = machine.plan(np.random.default_rng(9))
    names = known.families(machine, plan)
    assert set(names) >= {"reversal", "pitch_error", "positioning", "thermal_drift", "frame_shift", "refraction_scale"}
    assert not {"squareness", "harmonic", "table_load", "cross_axis"} & set(names)
    rng = np.random.default_rng(10)
    found = {name: known.drawn(rng, machine, plan, name, 60.0) for name in names}
    assert None not in found.values()
    # With unknown target positions, a zero offset shifts all targets of the slide equally and is not identifiable.
    unknown = replace(machine, places_known=False)
    assert known.drawn(rng, unknown, unknown.plan(rng), "zero_offset", 60.0) is None


def test_two_effects_do_not_stand_for_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """A zero offset is the constant of a positioning curve, so these two are never paired."""
    machine = few("stage")
    plan = machine.plan(np.random.default_rng(14))
    kept = {name: known.FAMILIES[name] for name in ("positioning", "zero_offset", "reversal")}
    monkeypatch.setattr(known, "FAMILIES", kept)
    rng = np.random.default_rng(15)
    pairs = [{one.effect for one in known.two(rng, machine, plan, 60.0)} for _ in range(10)]
    assert {"positioning", "reversal"} in pairs and {"positioning", "zero_offset"} not in pairs


def test_the_directions_of_a_stage_are_known(tmp_path: Path) -> None:
    """Straightness in Y and Z differ only by a rotation of the station about the axis; known target positions separate them."""
    machine = machines()["stage"]
    plan = machine.plan(np.random.default_rng(13))
    bent = Hidden("straightness", "E_YX", {"c0": -5.0, "c1": 0.0, "c2": 15.0})
    path = write_table(tmp_path / "measured.csv", plan, machine.readings(plan, [bent]), machine.sigma_mm)
    own = Machine.load(machine.write_machine(tmp_path))
    found = diagnose(Measurements.load(path, own), own, Calibration.zero(own))
    assert [(one.effect, one.where) for one in found.causes] == [bent.key]
    assert [q.value for q in found.causes[0].parameters][2] == pytest.approx(15.0, abs=0.01)


# --- scores ---------------------------------------------------------------------------------------------------------------------


def truth(effects: Sequence[dict[str, Any]] = (), outside: dict[str, Any] | None = None) -> dict[str, Any]:
    return {"effects": list(effects), "outside": outside}


def hides(effect: str, where: str, origin: str = "machine", **numbers: float) -> dict[str, Any]:
    parameters = [{"name": name, "value": value} for name, value in numbers.items()]
    return {"effect": effect, "where": where, "origin": origin, "parameters": parameters}


def cause(
    effect: str, where: str, *equivalent: tuple[str, str], origin: str = "machine", **numbers: Any
) -> dict[str, Any]:
    """Return a cause; ``numbers``: value and u by parameter name."""
    return {
        "effect": effect,
        "where": where,
        "origin": origin,
        "parameters": [{"name": name, "value": value, "u": u} for name, (value, u) in numbers.items()],
        "equivalent": [{"effect": one, "where": place} for one, place in equivalent],
    }


def said(
    verdict: str | None, *causes: dict[str, Any], left: Sequence[str] | None = None, held: Sequence[float] = ()
) -> dict:
    diagnosis = {
        "verdict": verdict,
        "causes": list(causes),
        "unexplained": None if left is None else {"depends_on": list(left)},
        "gain": {"held_out": dict(zip(("rms_before_um", "rms_after_um"), held, strict=True))} if held else None,
    }
    return {"diagnosis": diagnosis if verdict else None, "seconds": 2.0}


REVERSAL = hides("reversal", "Y", size=5.0)


def test_a_right_answer_scores() -> None:
    found = scores(truth([REVERSAL]), said("explained", cause("reversal", "Y", size=(5.3, 0.2)), held=(5.0, 3.0)))
    assert found == {
        "no answer": 0.0,
        "seconds": 2.0,
        "false machine": 0.0,
        "group size": 1.0,
        "right": 1.0,
        "in group": 1.0,
        "too many": 0.0,
        "size": 1.0,
        "gain": 1.0,
    }


def test_a_size_beyond_its_interval_and_a_loss_held_out() -> None:
    found = scores(truth([REVERSAL]), said("explained", cause("reversal", "Y", size=(5.5, 0.2)), held=(3.0, 5.0)))
    assert (found["right"], found["size"], found["gain"]) == (1.0, 0.0, 0.0)


def test_a_size_of_several_parameters() -> None:
    """Phases are periodic, orders exact; a coefficient absent from the truth is zero, one absent from the answer is wrong."""
    pitch = hides("pitch_error", "X", amplitude=3.0, period=10.0, phase=3.1)
    named = cause("pitch_error", "X", amplitude=(3.1, 0.1), period=(10.1, 0.01), phase=(-3.1, 0.1))
    assert scores(truth([pitch]), said("explained", named))["size"] == pytest.approx(2 / 3)
    curve = hides("straightness", "E_ZY", c0=-2.0, c2=6.0)
    named = cause("straightness", "E_ZY", c0=(-2.0, 0.1), c1=(0.5, 0.1))
    assert scores(truth([curve]), said("explained", named))["size"] == pytest.approx(1 / 3)
    harmonic = hides("harmonic", "E_XC", order=3.0, cos=4.0, sin=0.0)
    named = cause("harmonic", "E_XC", order=(3.0, 0.0), cos=(4.0, 0.1), sin=(0.1, 0.1))
    assert scores(truth([harmonic]), said("explained", named))["size"] == 1.0


def test_a_group_stands_for_one_effect() -> None:
    two = [REVERSAL, hides("squareness", "E_B0Z", angle=20.0)]
    both = cause("zero_offset", "B", ("reversal", "Y"), ("squareness", "E_B0Z"))
    found = scores(truth(two), said("ambiguous", both))
    assert (found["right"], found["in group"], found["group size"], found["false machine"]) == (0.0, 0.0, 3.0, 0.0)
    found = scores(truth(two), said("ambiguous", both, cause("squareness", "E_B0Z")))
    assert (found["right"], found["in group"]) == (0.0, 1.0)


def test_one_too_many_and_a_false_cause_of_the_machine() -> None:
    found = scores(truth([REVERSAL]), said("explained", cause("reversal", "Y"), cause("pitch_error", "X")))
    assert (found["right"], found["too many"], found["false machine"]) == (1.0, 1.0, 1.0)
    drift = cause("station_drift", "1", origin="instrument")
    found = scores(truth([REVERSAL]), said("explained", cause("reversal", "Y"), drift))
    assert (found["too many"], found["false machine"]) == (1.0, 0.0)


def test_a_pattern_outside() -> None:
    pattern = {"depends_on": ["X_mm", "Y_mm"]}
    found = scores(truth(outside=pattern), said("unexplained", left=["Y_mm", "time_s"]))
    assert (found["unexplained"], found["right column"], found["false machine"]) == (1.0, 1.0, 0.0)
    found = scores(truth(outside=pattern), said("unexplained", cause("pitch_error", "X"), left=["time_s"]))
    assert (found["unexplained"], found["right column"], found["false machine"]) == (1.0, 0.0, 1.0)
    found = scores(truth(outside=pattern), said("explained", cause("pitch_error", "X"), left=["X_mm"]))
    assert found["unexplained"] == 0.0
    # Together with a known effect either verdict is right, but `unexplained` must be given.
    found = scores(truth([REVERSAL], pattern), said("explained", cause("reversal", "Y"), left=["X_mm"]))
    assert (found["unexplained"], found["right column"], found["right"]) == (1.0, 1.0, 1.0)


def test_silence() -> None:
    assert scores(truth(), said("consistent"))["alarm"] == 0.0
    assert scores(truth(), said("unexplained", left=["X_mm"]))["alarm"] == 1.0
    missing = scores(truth([REVERSAL]), said(None))
    assert (missing["no answer"], missing["right"], missing["in group"]) == (1.0, 0.0, 0.0)


def test_what_is_wrong_is_said_in_a_line() -> None:
    pattern = {"pattern": "jump", "columns": ["X_mm"], "side": "tool", "depends_on": ["X_mm"]}
    hidden = truth([REVERSAL], pattern)
    named = said("ambiguous", cause("reversal", "Y", ("zero_offset", "Y")), cause("pitch_error", "X"), left=["X_mm"])
    assert is_wrong(scores(hidden, named))
    assert in_words(hidden, named) == (
        "reversal Y, jump of X_mm on the tool side → "
        "ambiguous: reversal Y or zero_offset Y, pitch_error X, unexplained by X_mm"
    )
    right = said("ambiguous", cause("reversal", "Y", ("zero_offset", "Y")), left=["X_mm"])
    assert not is_wrong(scores(hidden, right))
    assert is_wrong(scores(truth(), said("unexplained", left=["X_mm"])))
    assert not is_wrong(scores(truth(), said("consistent")))


def test_a_table_has_means_by_method_machine_and_kind() -> None:
    one, two = {"right": 1.0, "seconds": 1.0}, {"right": 0.0, "seconds": 2.0, "size": 0.5}
    header, body = rows(
        [("twin", "stage", "known30", one), ("twin", "stage", "known30", two), ("lasso", "stage", "known30", one)]
    )
    assert header == ["method", "machine", "case", "cases", "right", "size", "seconds"]
    assert body == [
        ["twin", "stage", "known30", "2", "50 %", "50 %", "1.5"],
        ["lasso", "stage", "known30", "1", "100 %", "–", "1.0"],
    ]
    assert markdown(header, body).splitlines()[1] == "| --- | --- | --- | --- | --- | --- | --- |"
    assert text(header, body).splitlines()[2].split() == [*body[1][:4], "100", "%", "–", "1.0"]


def test_probabilities_are_compared_with_what_is_there() -> None:
    """A cause counts with its equivalents; one without a probability does not count."""
    right = {**cause("reversal", "Y"), "probability": 0.97}
    in_group = {**cause("reversal", "X", ("reversal", "Y")), "probability": 0.92}
    false = {**cause("squareness", "E_C0Y"), "probability": 0.96}
    answer = said("ambiguous", right, in_group, false, cause("reversal", "Y"))
    found = probabilities(truth([REVERSAL]), answer)
    assert found == [(0.97, True), (0.92, True), (0.96, False)]
    assert probabilities(truth([REVERSAL]), said(None)) == []
    header, body = reliability({"twin": found, "lasso": []})
    assert header == ["method", "probability stated", "causes", "mean", "there"]
    assert body == [["twin", "90 to 95 %", "1", "92.0 %", "100.0 %"], ["twin", "95 to 99 %", "2", "96.5 %", "50.0 %"]]


# --- runs -----------------------------------------------------------------------------------------------------------------------

PLAIN = """
import json, sys
from pathlib import Path
table, machine, answer, log = sys.argv[1:]
with open(log, "a") as file:
    file.write(table + "\\n")
assert Path(machine).exists() and Path(table).name == "measured.csv"
Path(answer).write_text(json.dumps({"verdict": "consistent", "causes": [], "unexplained": None, "gain": None}))
"""


def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    (tmp_path / "plain.py").write_text(PLAIN, encoding="utf-8")
    log = tmp_path / "log"
    words = [sys.executable, str(tmp_path / "plain.py"), "{table}", "{machine}", "{json}", str(log)]
    method = Command("plain", shlex.join(words))
    cases = [Case("stage", kind, number) for kind in ("nothing", "known60") for number in (0, 1)]
    once = benchmark.run(tmp_path, [method], cases[:3], benchmark.Workers(1))
    assert len(log.read_text(encoding="utf-8").splitlines()) == 3 and len(once[1]) == 2
    whole = benchmark.run(tmp_path, [method], cases, benchmark.Workers(1))
    again = benchmark.run(tmp_path, [method], cases, benchmark.Workers(1))
    asked_of = log.read_text(encoding="utf-8").splitlines()
    assert len(asked_of) == 4 and len(set(asked_of)) == 4
    assert again == whole
    assert [row[3] for row in whole[1]] == ["2", "2"]
    assert dict(zip(*(whole[0], whole[1][0]), strict=True))["alarm"] == "0 %"
    # Two cases with hidden errors.
    wrong = (tmp_path / "wrong.txt").read_text(encoding="utf-8").splitlines()
    assert [line.split(":")[0] for line in wrong] == ["plain stage-known60-1-000", "plain stage-known60-1-001"]
    assert all(line.endswith("→ consistent: nothing") for line in wrong)
    families = benchmark.run(tmp_path, [method], cases, benchmark.Workers(1), by_family=True)
    assert [row[2].split()[0] for row in families[1]] == ["nothing", "known60", "known60"]


def test_cases_are_the_same_wherever_they_are_drawn(tmp_path: Path) -> None:
    case = Case("stage", "mixed300", 3)
    first, second = (write_case(case, tmp_path / name) for name in ("a", "b"))
    for name in ("measured.csv", "truth.json"):
        assert (first / name).read_bytes() == (second / name).read_bytes()
    other = write_case(replace(case, number=4), tmp_path / "a")
    assert (other / "measured.csv").read_bytes() != (first / "measured.csv").read_bytes()


def test_a_command_that_fails_has_no_answer(tmp_path: Path) -> None:
    method = Command("broken", shlex.join([sys.executable, "-c", "import sys; sys.exit('no such luck')"]))
    found = run_method(method, tmp_path / "measured.csv", "dmu50")
    assert found["diagnosis"] is None and found["error"] == "exit status 1: no such luck"
    assert scores(truth([REVERSAL]), found)["no answer"] == 1.0


class Broken(Method):
    name = "broken"

    def diagnose(self, table: Path, machine: str, answer: Path, calibration: Path) -> str:
        raise np.linalg.LinAlgError("singular matrix")


def test_a_method_that_breaks_does_not_stop_the_others(tmp_path: Path) -> None:
    header, body = benchmark.run(tmp_path, [Broken()], [Case("stage", "nothing", 0)], benchmark.Workers(1))
    assert dict(zip(header, body[0], strict=True))["no answer"] == "100 %"
    wrong = (tmp_path / "wrong.txt").read_text(encoding="utf-8")
    assert wrong == "broken stage-nothing-1-000: nothing → no answer: LinAlgError: singular matrix\n"


@pytest.mark.slow
def test_twin_and_its_plain_rivals_answer_from_files(tmp_path: Path) -> None:
    """For a reversal of λ = 300 on a stage, all methods give its name and `twin` also its size."""
    effect = (("reversal", "X"),)
    number = next(k for k in range(20) if names_of(Case("stage", "known300", k)) == effect)
    case = Case("stage", "known300", number)
    methods = [benchmark.BUILT_IN[name] for name in ("twin", "stepwise-ebic", "lasso")]
    header, body = benchmark.run(tmp_path, methods, [case], benchmark.Workers(1))
    for row in body:
        one = dict(zip(header, row, strict=True))
        assert one["right"] == "100 %" and one["no answer"] == "0 %"
    assert body[0][header.index("size")] != "–" and body[1][header.index("size")] == "–"
    # At λ = 300 the size is known to 6 %: the expected remaining sum of squares is 1/300.
    assert int(body[0][header.index("removed")].removesuffix(" %")) > 95


def test_what_a_calibration_removes(tmp_path: Path) -> None:
    """A correction by 1, ½, 2 or −1 times the reversal removes 1, ¾, 0 or −3 of the sum of squares."""
    case = next(
        one for one in (Case("stage", "known60", k) for k in range(40)) if names_of(one) == (("reversal", "X"),)
    )
    folder = write_case(case, tmp_path)
    machine = (folder / "machine.txt").read_text(encoding="utf-8").strip()
    own = Machine.load(machine)
    size = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["effects"][0]["parameters"][0]["value"]
    for factor, share in ((1.0, 1.0), (0.5, 0.75), (2.0, 0.0), (-1.0, -3.0)):
        effect = effect_named("reversal", "X", {"size": factor * size}, own)
        Calibration.zero(own).extended([effect], Covariance.none(), "a test").save(tmp_path / "c.yaml")
        # One minus the square of the remaining share, exact except for the digits of the file.
        assert removed(case, folder / "measured.csv", machine, tmp_path / "c.yaml") == pytest.approx(share, abs=1e-3)
    nothing = write_case(Case("stage", "nothing", 0), tmp_path)
    assert removed(Case("stage", "nothing", 0), nothing / "measured.csv", machine, tmp_path / "c.yaml") is None


def names_of(case: Case) -> tuple[tuple[str, str], ...]:
    from tests.scored_cases.cases import truth_of

    return tuple(effect.key for effect in truth_of(case).effects)


def test_kinds_are_those_of_the_issue() -> None:
    assert {kind for kind in KINDS if kind.startswith("outside")} == {f"outside-{pattern}" for pattern in PATTERNS}
    assert {"known30", "known60", "known300", "two60", "nothing"} <= set(KINDS)


# --- real sets ------------------------------------------------------------------------------------------------------------------


def answer(*causes: dict[str, Any], share: float | None = None, **more: Any) -> Answer:
    left = None if share is None else {"share": share, "depends_on": []}
    diagnosis = {"verdict": "explained", "causes": list(causes), "unexplained": left, "gain": more}
    return Answer(diagnosis, None, Path("t"), Path("m"))


def failed(name: str, given: Answer) -> list[str]:
    return next(one for one in REAL_SETS if one.name == name).failed(given)


def test_what_a_real_set_must_show() -> None:
    frame = cause("thermal_growth", "X by frame", coefficient=(33.0, 0.1))
    assert failed("printer run3, no time", answer(frame, share=0.002)) == []
    assert failed("printer run3, no time", answer(frame, cause("thermal_drift", "X"), share=0.3)) == [
        "no cause but frame and bed",
        "at most a tenth unexplained",
    ]
    assert len(failed("printer run3, no time", answer())) == 2
    assert failed("printer, dead sensor", Answer(None, None, Path("t"), Path("m"))) == []
    arm = [cause("read_back", "J2"), cause("gravity_compliance", "J3", compliance=(2.0, 0.1))]
    held = {"rms_before_um": 130.0, "rms_after_um": 71.0}
    assert failed("robot IRB120", answer(*arm, held_out=held)) == []
    assert failed("robot IRB120", answer(*arm, cause("reversal", "J1"), held_out=held)) == ["no reversal of J1"]
    curve = cause("positioning", "E_XX")
    reversal = cause("reversal", "X", size=(-1.7, 0.3))
    assert failed("stage z", answer(reversal)) == []
    assert failed("stage z", answer(reversal, curve)) == ["nothing promised between positions"]
    assert failed("stage z", answer(reversal, curve, tool_point={"after_um": 20.0})) == []
