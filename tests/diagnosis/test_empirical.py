"""The empirical effect: its functions, frames, entry in a calibration file, and range.

What a shift does to measured points comes from `tests.truth.hidden`, which shares no code with `twin`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.truth import hidden
from tests.truth.few_axes import write_robot
from twin import cli
from twin._common.errors import InputError
from twin.compensation import Compensator, Options
from twin.compensation.programs.execute import execute_file
from twin.diagnosis.patterns import patterns
from twin.machine.machine import Machine
from twin.measurement.observation import Observation
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.calibration_file import acting_frame, unused_place
from twin.model.conditions import Conditions
from twin.model.effects import Empirical, assemble
from twin.model.effects.harmonic import Waves, label, terms
from twin.nc import dialect_for
from twin.numerics.covariance import Covariance
from twin.tool.forward import Kinematics

AXES = "XYZBC"
X = Waves("X_mm", "half_waves", 3, (0.0, 500.0))
B = Waves("B_deg", "half_waves", 2, (0.0, 180.0))
C = Waves("C_deg", "whole_turns", 2)
SIDE_Y = Waves("approach_Y", "direction", 1)
BED = Waves("T_bed_degC", "half_waves", 2, (18.0, 24.0))
HEAD = "schema: twin.calibration/1\nmachine: DMU 50 eVolution\nsource: a test\n"
ENTRY = """effects:
- effect: empirical
  where: tool by X_mm
  cause: unknown
  along: base
  columns:
  - {column: X_mm, functions: half_waves, order: 2, range: [100, 400]}
  parameters: {'z[1]': 10.0}
"""


def empirical(
    machine: Machine, side: str, along: str, columns: Sequence[Waves], numbers: dict[str, float] | None = None
) -> Empirical:
    """With all coefficients drawn, or those given."""
    names = [name for own in Empirical.names(columns) for name in own]
    drawn = dict(zip(names, np.random.default_rng(7).normal(size=len(names)).tolist(), strict=True))
    frame, turning = acting_frame(side, along, machine)  # type: ignore[arg-type]
    where = unused_place(side, columns, [])
    return Empirical(where, along, columns, numbers or drawn, frame, turning)  # type: ignore[arg-type]


def extended(calibration: Calibration, *effects: Empirical) -> Calibration:
    names = tuple(parameter.name for effect in effects for parameter in effect.parameters)
    factor = np.random.default_rng(8).normal(size=(len(names), len(names)))
    return calibration.extended(effects, Covariance(names, factor @ factor.T), "a test")


# ---- its functions


def test_functions_are_those_of_their_formulas() -> None:
    x, theta = np.array([0.0, 120.0, 500.0]), np.array([-30.0, 45.0, 400.0])
    for k, found in enumerate(X.values(x), start=1):
        assert found == pytest.approx(np.cos(k * np.pi * x / 500.0))
    expected = [f(k * np.radians(theta)) for k in (1, 2) for f in (np.cos, np.sin)]
    assert np.array(C.values(theta)) == pytest.approx(np.array(expected))
    (side,) = SIDE_Y.values(np.array([1.0, -1.0, 0.0]))
    assert side.tolist() == [1.0, -1.0, 0.0]
    assert [label([X, C], term) for term in terms([X, C])][:8] == "1,0 2,0 3,0 0,c1 0,s1 0,c2 0,s2 1,c1".split()
    assert [label([SIDE_Y, X], term) for term in terms([SIDE_Y, X])] == ["1,0", "1,1", "1,2", "1,3"]


def test_an_axis_without_limits_is_wrapped_into_its_range() -> None:
    waves = Waves("C_deg", "half_waves", 2, (20.0, 100.0), wrapped=True)
    assert np.array(waves.values(np.array([60.0 + 720.0]))) == pytest.approx(np.array(waves.values(np.array([60.0]))))
    assert waves.outside(np.array([20.0, 100.0, 460.0, -260.0, 19.0, 101.0])).tolist() == [False] * 4 + [True] * 2


def test_patterns_and_the_effect_are_the_same_functions(dmu50: Machine, tmp_path: Path) -> None:
    """Every pattern of a table at its rows: as in the diagnosis, and as an effect of the same columns."""
    of = hidden.rounded(hidden.plan(np.random.default_rng(3), poses=8))
    data = Measurements.load(hidden.write(tmp_path / "m.csv", of, hidden.points(of), u_mm=3e-3), dmu50)
    state = {name: of.at(name) for name in AXES} | {f"approach_{a}": of.approach[:, i] for i, a in enumerate(AXES)}
    state |= {f"T_{name}_degC": values for name, values in of.warm.items()}
    tried = [one for one in patterns(dmu50, data) if not {"time_s", "round"} & set(one.names)]
    assert len(tried) > 100
    for pattern in tried:
        level = pattern.levels[0]
        columns = pattern.waves(level)
        names = Empirical.names(columns)[0]
        made = pattern.at(slice(None))[:, pattern.order <= level]
        assert made.shape[1] == len(names)
        for k in (0, len(names) // 2, len(names) - 1):
            effect = empirical(dmu50, pattern.side, "base", columns, {names[k]: 1.0})
            assert effect.shift(state)[pattern.own, 0] == pytest.approx(made[pattern.own, k], abs=1e-12)


# ---- where it acts


@pytest.mark.parametrize(("side", "along"), [("tool", "base"), ("tool", "tool"), ("work", "base"), ("work", "work")])
def test_points_shift_by_it_along_its_axes(dmu50: Machine, side: str, along: str) -> None:
    """Along the base's axes at any table position, or along those of the side that carries the targets: exact to the last digit."""
    of = hidden.plan(np.random.default_rng(5), poses=20)
    effect = empirical(dmu50, side, along, [X, B])
    shift = np.zeros((len(of.q), 3))
    u, v = of.at("X") / 500.0, of.at("B") / 180.0
    for name, value in effect.coefficients.items():
        i, j = (int(part) for part in name[2:-1].split(","))
        shift[:, "xyz".index(name[0])] += 1e-3 * value * np.cos(i * np.pi * u) * np.cos(j * np.pi * v)
    shift *= (of.carrier == side)[:, None]
    moved = shift if along == "base" else hidden.turned(of, shift)
    places = np.array([hidden.TARGETS[name][1] for name in of.target])
    state = {name: of.at(name) for name in AXES}
    rows = assemble([effect], dmu50.frames, state)
    errors = np.stack([np.broadcast_to(np.asarray(v, dtype=float), len(of.q)) for row in rows for v in row], axis=1)
    found = Observation(dmu50).points(of.q * dmu50.scale, errors, of.carrier, places * 1e-3) * 1e3
    still = hidden._carried(of, {name: np.zeros((len(of.q), 6)) for name in (*AXES, "L_B", "L_C")}, places)
    assert found == pytest.approx(still + moved, abs=1e-9)


def test_on_a_robot_it_shifts_along_the_tool_that_its_last_axis_turns(tmp_path: Path) -> None:
    """All axes turn: along the base at the first axis, along the tool at the last one, whose own turning is taken out."""
    machine = Machine.load(write_robot(tmp_path))
    column = Waves("J2_deg", "half_waves", 1, (-90.0, 90.0))
    q = np.random.default_rng(1).uniform(-80.0, 80.0, (5, 6))
    for along in ("base", "tool"):
        effect = empirical(machine, "tool", along, [column], {"x[1]": 5.0, "y[1]": -3.0, "z[1]": 2.0})
        real = Kinematics(machine, extended(Calibration.zero(machine), effect)).forward(q)
        nominal = Kinematics(machine, Calibration.zero(machine)).forward(q)
        shift = np.array([5.0, -3.0, 2.0]) * np.cos(np.pi * (q[:, [1]] + 90.0) / 180.0)
        wanted = shift if along == "base" else np.einsum("nij,nj->ni", nominal.rotation, shift)
        # The work frame of this robot is its base.
        assert (real.point_mm - nominal.point_mm) * 1e3 == pytest.approx(wanted, abs=1e-6)
        assert real.rotation == pytest.approx(nominal.rotation, abs=1e-12)


def test_a_side_that_no_axis_moves_has_none(tmp_path: Path) -> None:
    machine = Machine.load(write_robot(tmp_path))
    with pytest.raises(InputError, match="no axis of arm moves the work"):
        acting_frame("work", "base", machine)


@pytest.mark.parametrize("columns", [[X], [X, B], [C], [C, X], [SIDE_Y, X], [X, BED]])
def test_expressions_arrays_and_derivatives_agree(dmu50: Machine, columns: list[Waves]) -> None:
    effect = empirical(dmu50, "work", "work", columns)
    rng = np.random.default_rng(2)
    names = [*AXES, "approach_Y", "T_bed_degC"]
    low, high = np.array([0, 0, -400, 0, 0, -1, 18.0]), np.array([500, 450, 0, 180, 360, 1, 24.0])
    at = rng.uniform(low, high, (6, 7))
    symbol = ca.SX.sym("q", 7)
    made = effect.components({name: symbol[i] for i, name in enumerate(names)})
    function = ca.Function("f", [symbol], [ca.vertcat(*made.values()), ca.jacobian(ca.vertcat(*made.values()), symbol)])
    arrays = effect.components({name: at[:, i] for i, name in enumerate(names)})
    rates = effect.derivatives({name: at[:, i] for i, name in enumerate(names)})
    values = np.array([parameter.value for parameter in effect.parameters])
    step = 1e-4
    for n, row in enumerate(at):
        found, slope = (np.array(one) for one in function(row))
        assert found.ravel() == pytest.approx([arrays[i][n] for i in made], abs=1e-12)
        for j in range(7):
            ends = [np.array(function(row + sign * step * np.eye(7)[j])[0]).ravel() for sign in (1.0, -1.0)]
            assert slope[:, j] == pytest.approx((ends[0] - ends[1]) / (2.0 * step), abs=1e-6)
        for i in made:
            assert sum(v * rate[i][n] for v, rate in zip(values, rates, strict=True) if i in rate) == pytest.approx(
                arrays[i][n], abs=1e-12
            )


# ---- its entry


numbers = st.floats(-2e4, 2e4, allow_nan=False)


@st.composite
def drawn(draw: st.DrawFn) -> tuple[str, str, list[Waves], dict[str, float]]:
    def ranged(column: str, orders: int) -> Waves:
        low = draw(st.floats(-500.0, 500.0))
        high = low + draw(st.floats(1e-3, 300.0))
        return Waves(column, "half_waves", draw(st.integers(1, orders)), (low, high), column == "C_deg")

    pool = [
        ranged("X_mm", 5),
        ranged("C_deg", 4),
        ranged("T_bed_degC", 2),
        Waves("B_deg", "whole_turns", draw(st.integers(1, 3))),
        Waves("approach_Z", "direction", 1),
    ]
    columns = draw(st.lists(st.sampled_from(pool), min_size=1, max_size=2, unique_by=lambda one: one.column))
    columns.sort(key=lambda one: one.kind != "direction")
    names = [name for own in Empirical.names(columns) for name in own]
    chosen = draw(st.lists(st.sampled_from(names), min_size=1, max_size=6, unique=True))
    side = draw(st.sampled_from(["tool", "work"]))
    return side, draw(st.sampled_from(["base", side])), columns, {name: draw(numbers) for name in chosen}


@pytest.mark.slow
@given(drawn())
@settings(max_examples=60)
def test_a_file_gives_back_the_same(dmu50: Machine, tmp_path_factory: pytest.TempPathFactory, given: tuple) -> None:
    side, along, columns, own = given
    effect = empirical(dmu50, side, along, columns, own)
    calibration = extended(Calibration.zero(dmu50), effect)
    path = tmp_path_factory.mktemp("round") / "c.yaml"
    calibration.save(path)
    back = Calibration.load(path, dmu50)
    (again,) = back.empirical
    assert (again.name, again.along, again.columns, again.coefficients) == (
        effect.name,
        effect.along,
        effect.columns,
        effect.coefficients,
    )
    assert again.frame == effect.frame and np.array_equal(back.covariance.matrix, calibration.covariance.matrix)
    assert back.to_yaml() == calibration.to_yaml() and "cause: unknown" in back.to_yaml()


def test_a_second_effect_of_the_same_columns_has_its_own_name(dmu50: Machine, tmp_path: Path) -> None:
    """A calibration that was extended is extended again: both stay, with their uncertainties."""
    first = extended(Calibration.zero(dmu50), empirical(dmu50, "tool", "base", [X], {"x[1]": 1.0}))
    where = unused_place("tool", [X], [effect.name for effect in first.extra])
    frame, turning = acting_frame("tool", "base", dmu50)
    both = extended(first, Empirical(where, "base", [X], {"x[1]": 2.0}, frame, turning))
    both.save(tmp_path / "c.yaml")
    back = Calibration.load(tmp_path / "c.yaml", dmu50)
    assert [one.where for one in back.empirical] == ["tool by X_mm", "tool by X_mm (2)"]
    assert len(back.covariance.names) == 2
    state = {"X": np.array([0.0])}
    assert sum(one.shift(state)[0, 0] for one in back.empirical) == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("where: tool by X_mm", "where: tool by Y_mm", "no such place"),
        ("where: tool by X_mm", "where: spindle by X_mm", "no such place"),
        ("  cause: unknown\n", "", "without cause"),
        ("cause: unknown", "cause: worn", "'worn'"),
        ("along: base", "along: work", "other side"),
        ("  along: base\n", "", "without cause or along"),
        ("column: X_mm", "column: time_s", "no such place"),
        ("half_waves", "whole_turns", "functions of X_mm"),
        ("half_waves", "direction", "functions of X_mm"),
        ("half_waves", "polynomials", "polynomials"),
        ("order: 2", "order: 0", "order of X_mm"),
        (", order: 2", "", "order of X_mm"),
        ("range: [100, 400]", "range: [400, 100]", "range of X_mm"),
        (", range: [100, 400]", "", "range of X_mm"),
        ("'z[1]'", "'z[3]'", "no such parameter"),
        ("'z[1]'", "'w[1]'", "no such parameter"),
        ("{'z[1]': 10.0}", "{}", "no parameters"),
        ("10.0", "1e6", "no error of a machine"),
        ("effect: empirical", "effect: reversal", "known cause"),
        (
            "where: tool by X_mm\n",
            "where: tool by time_s\n",
            "no such place",
        ),
    ],
)
def test_an_entry_that_does_not_fit_is_refused(dmu50: Machine, tmp_path: Path, old: str, new: str, what: str) -> None:
    path = tmp_path / "c.yaml"
    assert old in ENTRY
    path.write_text(HEAD + ENTRY.replace(old, new, 1))
    with pytest.raises(InputError, match=what.replace("(", r"\(")) as caught:
        Calibration.load(path, dmu50)
    assert caught.value.file == str(path) and caught.value.line is not None


def test_time_is_no_column_of_a_later_program(dmu50: Machine, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(HEAD + ENTRY.replace("X_mm", "time_s"))
    with pytest.raises(InputError, match="no such column"):
        Calibration.load(path, dmu50)


# ---- its range


@pytest.fixture
def narrow(dmu50: Machine, tmp_path: Path) -> Calibration:
    """Measured over X 100 to 400 mm: +10 to −10 µm along z."""
    path = tmp_path / "narrow.yaml"
    path.write_text(HEAD + ENTRY)
    return Calibration.load(path, dmu50)


def compensated(text: str, calibration: Calibration, **options: object) -> np.ndarray:
    chosen = Options(tool_length_mm=120.0, **options)  # type: ignore[arg-type]
    dialect = dialect_for(Path("p.nc"))
    done = Compensator(calibration.machine, calibration, chosen).compensate(
        dialect.read(text.encode(), "p.nc"), dialect
    )
    return done.commands


START = "G21 G90\nG0 X200 Y100 Z-100 B0 C0\n"


@pytest.mark.parametrize(
    ("text", "line", "low", "high"),
    [
        ("G1 X300 F500\nG1 X400.5\n", 4, 400.5, 400.5),
        ("G1 X99.9 F500\n", 3, 99.9, 99.9),
        ("G0 X450\n", 3, 450.0, 450.0),
        # Both ends inside, the far side of the arc outside.
        ("G1 X390 Y100 F500\nG2 X390 Y60 I0 J-20\n", 4, 400.0, 410.0),
    ],
)
def test_a_program_outside_is_refused(narrow: Calibration, text: str, line: int, low: float, high: float) -> None:
    with pytest.raises(InputError, match="X_mm is outside the range") as caught:
        compensated(START + text + "M30\n", narrow)
    assert (caught.value.file, caught.value.line) == ("p.nc", line)
    assert "100 to 400" in caught.value.expected and "without that effect" in caught.value.expected
    assert low - 1e-9 <= float(str(caught.value.value)) <= high + 1e-9
    # Without the effect the same program is compensated.
    plain = Calibration.zero(narrow.machine)
    assert len(compensated(START + text + "M30\n", plain))


def test_a_program_inside_is_corrected_up_to_its_edge(narrow: Calibration) -> None:
    """The edge itself, whose corrected command may lie beyond; what rounding leaves of the range is inside."""
    ends = np.array([100.0, 175.0, 250.0, 325.0, 400.0])
    text = "".join(f"G1 X{x} F500\n" for x in ends)
    found = compensated(START + text + "M30\n", narrow)
    last = [found[np.flatnonzero(np.abs(found[:, 0] - x) < 1e-6)[-1]] for x in ends]
    # µm along z that the tool side shifts by is taken out of Z.
    wanted = -0.010 * np.cos(np.pi * (ends - 100.0) / 300.0)
    assert np.array(last)[:, 2] + 100.0 == pytest.approx(wanted, abs=0.0006)
    narrow.check(np.array([[400.0 + 2.9e-4, 0, 0, 0, 0]]))
    with pytest.raises(InputError, match="X_mm is outside"):
        narrow.check(np.array([[400.0 + 3.1e-4, 0, 0, 0, 0]]))


def test_the_command_refuses_and_writes_nothing(
    narrow: Calibration, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program, out = tmp_path / "p.nc", tmp_path / "out.nc"
    program.write_text(START + "G1 X450 F500\nM30\n")
    for words in (
        ("compensate", program, "-o", out, "-c", narrow.path, "--tool-length", 120),
        ("scene", program, "-o", tmp_path / "out.html", "-c", narrow.path),
        ("path", program, "-o", out, "-c", narrow.path),
        ("control", "--to", "siemens", "-o", tmp_path / "tables", "-c", narrow.path),
    ):
        with pytest.raises(SystemExit) as stopped:
            cli.main([str(word) for word in words])
        assert stopped.value.code == 2
        said = capsys.readouterr().err.strip()
        assert len(said.splitlines()) == 1 and "X_mm is outside the range" in said and "100 to 400" in said
    assert not out.exists() and not (tmp_path / "out.html").exists() and not (tmp_path / "tables").exists()


def test_a_table_outside_is_refused_with_its_line(narrow: Calibration, tmp_path: Path) -> None:
    of = hidden.plan(np.random.default_rng(3), poses=4)
    data = Measurements.load(hidden.write(tmp_path / "m.csv", of, hidden.points(of), u_mm=3e-3), narrow.machine)
    first = int(np.flatnonzero((of.at("X") < 100.0) | (of.at("X") > 400.0))[0])
    with pytest.raises(InputError, match="X_mm is outside") as caught:
        Observation(narrow.machine).errors(narrow, data)
    assert caught.value.line == first + 2 and caught.value.file is not None and "m.csv" in caught.value.file


def test_a_temperature_outside_is_refused(dmu50: Machine) -> None:
    calibration = extended(Calibration.zero(dmu50), empirical(dmu50, "tool", "base", [BED]))
    for warm in (18.0, 24.0):
        Kinematics(dmu50, calibration, conditions=Conditions({"bed": warm}))
    with pytest.raises(InputError, match="T_bed_degC is outside the range"):
        Kinematics(dmu50, calibration, conditions=Conditions({"bed": 24.1}))
    with pytest.raises(InputError, match="needs T_bed_degC"):
        Kinematics(dmu50, calibration)


def test_whole_turns_have_no_range_and_repeat(dmu50: Machine) -> None:
    calibration = extended(Calibration.zero(dmu50), empirical(dmu50, "work", "base", [C]))
    at = np.array([[100.0, 100.0, -100.0, 30.0, c] for c in (75.0, 75.0 + 3600.0)])
    found = Kinematics(dmu50, calibration).forward(at).point_mm
    assert found[0] == pytest.approx(found[1], abs=1e-9)


def test_a_volume_ends_where_the_range_does(narrow: Calibration) -> None:
    at = np.array([[x, 100.0, -100.0, 0.0, 0.0] for x in (50.0, 100.0, 250.0, 400.0, 450.0)])
    assert narrow.outside(at)[:, 0].tolist() == [True, False, False, False, True]
    assert not narrow.outside(at)[:, 1:].any()


def test_a_reversal_that_depends_on_the_position_follows_the_program(dmu50: Machine, tmp_path: Path) -> None:
    """The approach direction of Y follows from the program; at a reversal the correction changes at once, by an extra move."""
    along_z = Waves("Z_mm", "half_waves", 1, (-400.0, 0.0))
    effect = empirical(dmu50, "tool", "base", [SIDE_Y, along_z], {"x[1,0]": 4.0, "x[1,1]": 3.0})
    calibration = extended(Calibration.zero(dmu50), effect)
    text = START + "G1 Y150 F500\nG1 Y80\nG1 Z-300\nG1 Y120\nM30\n"
    path = tmp_path / "p.nc"
    path.write_text(text)
    found = compensated(text, calibration)
    # Y 150 from below, Y 80 from above, Z −300 still from above, Y 120 from below.
    for y, z, side in ((150.0, -100.0, 1.0), (80.0, -100.0, -1.0), (80.0, -300.0, -1.0), (120.0, -300.0, 1.0)):
        # The first row there ends the block; where Y then turns, another one takes it to the other side.
        row = found[np.flatnonzero((np.abs(found[:, 1] - y) < 1e-6) & (np.abs(found[:, 2] - z) < 1e-6))[0]]
        size = 4.0 + 3.0 * math.cos(math.pi * (z + 400.0) / 400.0)
        assert (row[0] - 200.0) * 1e3 == pytest.approx(-side * size, abs=0.6)
    done = execute_file(path, dmu50, calibration, tool_length_mm=120.0)
    last = done.ends & (done.lines == 4)
    assert (done.reached_mm - done.meant_mm)[last, 0] * 1e3 == pytest.approx(-(4.0 + 3.0 * math.cos(math.pi * 0.75)))
