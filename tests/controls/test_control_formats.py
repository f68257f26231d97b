"""Tests common to all formats of control tables: writing and reading agree, and with an independent evaluation of the files.

The independent evaluation of each format is in its module of `tests.controls.cases`.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.controls.cases import CASES
from twin._common.errors import InputError
from twin._common.families import BASIC
from twin._common.units import DEG
from twin.cli.doc import page_text
from twin.controls import ControlCurve, ControlTerm, Correction, TableFormat, TableSum, read_tables, table_formats
from twin.controls.correction import EXACT_UM, AxisErrors, CorrectionGrid, MatrixCorrection, VolumetricCorrection
from twin.controls.formats.linuxcnc import LinuxCnc
from twin.controls.formats.skew import SkewFormat
from twin.machine.machine import Machine

MACHINE = Machine.load("dmu50")
URAD_A_DEG = np.pi / 180.0 * 1e6
RANGES = {"X": (0.0, 500.0), "Y": (0.0, 450.0), "Z": (-400.0, 0.0), "B": (0.0, 180.0), "C": (0.0, 360.0)}
every_format = pytest.mark.parametrize("form", table_formats(), ids=lambda form: form.name)

values = st.floats(-150.0, 150.0).map(lambda value: round(value, 3))


def put(folder: Path, files: Mapping[str, str]) -> list[Path]:
    folder.mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text)
    return [folder / name for name in files]


@st.composite
def terms(draw: st.DrawFn, form: TableFormat[TableSum]) -> TableSum:
    """Draw tables that a format can hold: equally spaced nodes, the same in all tables over one axis."""
    found = []
    for of, (low, high) in RANGES.items():
        count = draw(st.sampled_from((2, 3, 5, 6, 9)))
        at = tuple(float(q) for q in np.linspace(low, high, count))
        period = 360.0 if of == "C" and form.wraps else None
        moved = (
            [of] if of in "BC" or not form.across else draw(st.lists(st.sampled_from("XYZ"), unique=True, max_size=3))
        )
        for axis in moved:
            two = draw(st.booleans()) and (form.crossed_directions or (form.directions and axis == of))
            for side in (1, -1) if two else (0,):
                curve = ControlCurve(
                    of, at, tuple(draw(st.lists(values, min_size=count, max_size=count))), period, side
                )
                found.append(ControlTerm(axis, (curve,)))
        if form.products and of in "XYZ" and draw(st.booleans()):
            by = draw(st.sampled_from([name for name in "XYZ" if name != of]))
            arm = ControlCurve(by, RANGES[by], (draw(st.floats(-1.0, 1.0)), draw(st.floats(-1.0, 1.0))))
            curve = ControlCurve(of, at, tuple(draw(st.lists(values, min_size=count, max_size=count))))
            found.append(ControlTerm(draw(st.sampled_from("XYZ")), (curve, arm)))
    return TableSum(tuple(found), MACHINE)


@st.composite
def component_errors(draw: st.DrawFn, form: TableFormat[VolumetricCorrection]) -> VolumetricCorrection:
    rng = np.random.default_rng(draw(st.integers(0, 1000)))
    errors = []
    for name, (low, high) in RANGES.items():
        at = tuple(np.linspace(low, high, draw(st.integers(2, 7))).round(4))
        scale, period = [20.0] * 3 + [80.0] * 3, 360.0 if name == "C" else None
        chosen = draw(st.lists(st.integers(0, 5), unique=True, min_size=1))
        curves = {i: ControlCurve(name, at, tuple(rng.normal(0, scale[i], len(at)).round(3)), period) for i in chosen}
        errors.append(AxisErrors(name, curves))
    return VolumetricCorrection(tuple(errors), MACHINE, 137.5)


@st.composite
def grids(draw: st.DrawFn, form: TableFormat[CorrectionGrid]) -> CorrectionGrid:
    counts = [draw(st.integers(2, 5)) for _ in range(3)]
    at = tuple(tuple(np.linspace(*RANGES[name], n).round(4)) for name, n in zip("XYZ", counts, strict=True))
    rng = np.random.default_rng(draw(st.integers(0, 1000)))
    return CorrectionGrid(MACHINE, at, rng.normal(0, 40, (*counts, 3)))


@st.composite
def matrices(draw: st.DrawFn, form: SkewFormat) -> MatrixCorrection:
    """Draw skew and scale of up to 9 mm per m, in the entries that a firmware has."""
    entry = st.floats(-0.009, 0.009)
    rows = [[draw(entry) if form.holds(moved, by) and draw(st.booleans()) else 0.0 for by in "XYZ"] for moved in "XYZ"]
    return MatrixCorrection(MACHINE, np.array(rows))


DRAWN = {
    TableSum: terms,
    VolumetricCorrection: component_errors,
    CorrectionGrid: grids,
    MatrixCorrection: matrices,
}


@every_format
@settings(max_examples=15)
@given(data=st.data())
def test_tables_survive_writing_and_reading(
    form: TableFormat, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    case, meant = CASES[form.name], data.draw(DRAWN[form.correction](form))
    if not meant.axes:
        return
    folder = tmp_path_factory.mktemp(form.name)
    files = form.write(meant, ("a note",))
    assert set(files) <= set(form.files(MACHINE)) and set(form.to_read(files)) | set(form.unread) >= set(files)
    put(folder, files)
    back = form.read([folder / name for name in form.to_read(files)], MACHINE)
    assert isinstance(back, form.correction)
    assert form.write(back, ("a note",)) == files
    rng = np.random.default_rng(3)
    beyond, count = (0.0, 12) if form.knows_machine else (20.0, 50)  # the evaluation by hand does one pose at a time
    state = {name: rng.uniform(low - beyond, high + beyond, count) for name, (low, high) in RANGES.items()}
    state |= {f"approach_{name}": rng.choice([-1.0, 0.0, 1.0], count) for name in RANGES}
    assert set(back.axes) <= set(meant.axes)
    for axis in back.axes:
        # Rounding of every value that moves the axis; of a product also of its second table, 1e-9 of 150 µm, and of an angle times
        # its lever of one metre.
        allowed = form.rounding[0 if axis in "XYZ" else 1] * 1.01 * meant.rounded(axis) + 1e-6
        assert np.abs(back.shift(axis, state) - meant.shift(axis, state)).max() <= allowed
        assert np.abs(case.by_hand(folder, axis, state) - back.shift(axis, state)).max() <= case.AGREES_UM


@every_format
def test_every_format_is_documented(form: TableFormat) -> None:
    """The module gives the sources, the manual has the format's row, and its limits are set."""
    module = inspect.getmodule(type(form))
    assert module is not None and len(module.__doc__ or "") > 300
    if form.unchecked:
        assert "**Not checked**" in module.__doc__
    assert f"| `{form.name}` {form.what} | {form.carries} | {form.leaves} |" in page_text("control")
    assert list(form.classes) == [name for name in BASIC if name in form.classes] != []
    assert form.points >= 2 and min(form.rounding) >= 0.0 < form.tolerance_um
    assert [one.name for one in table_formats()].count(form.name) == 1


@every_format
def test_the_valid_files_of_the_cases_are_read(form: TableFormat, tmp_path: Path) -> None:
    assert form.read(put(tmp_path, CASES[form.name].GOOD), MACHINE).axes


@pytest.mark.parametrize(
    ("kind", "file", "old", "new", "line", "what"),
    [(name, *bad) for name, case in CASES.items() for bad in case.BAD],
)
def test_refused(kind: str, file: str, old: str, new: str, line: int | None, what: str, tmp_path: Path) -> None:
    good = CASES[kind].GOOD
    assert old in good[file]
    with pytest.raises(InputError, match=what) as caught:
        read_tables(kind, put(tmp_path, good | {file: good[file].replace(old, new, 1)}), MACHINE)
    assert caught.value.line == line
    assert Path(str(caught.value.file)).name == file


def examples() -> list[tuple[str, Correction]]:
    rng = np.random.default_rng(11)

    def curve(of: str, n: int, side: int = 0) -> ControlCurve:
        low, high = RANGES[of]
        return ControlCurve(
            of, tuple(np.linspace(low, high, n)), tuple(rng.normal(0, 30, n)), 360.0 if of == "C" else None, side
        )

    found = TableSum(
        (
            ControlTerm("X", (curve("X", 12),)),
            ControlTerm("Y", (curve("X", 5, 1),)),
            ControlTerm("Y", (curve("X", 7, -1),)),
            ControlTerm("Z", (curve("Y", 6), ControlCurve("Z", (-400.0, 0.0), (-1.0, 1.0)))),
            ControlTerm("C", (curve("C", 13),)),
            ControlTerm("B", (ControlCurve("B", (90.0,), (4.0,)),)),
        ),
        MACHINE,
    )
    errors = [AxisErrors(name, {i: curve(name, 6) for i in range(6)}) for name in RANGES]
    at = tuple(tuple(np.linspace(*RANGES[name], 6)) for name in "XYZ")
    return [
        ("terms", found),
        ("isg", VolumetricCorrection(tuple(errors), MACHINE, 80.0)),
        ("grid", CorrectionGrid(MACHINE, at, rng.normal(0, 30, (6, 6, 6, 3)))),
        ("matrix", MatrixCorrection(MACHINE, rng.normal(0, 1e-3, (3, 3)))),
    ]


@pytest.mark.parametrize(("name", "correction"), examples(), ids=lambda one: one if isinstance(one, str) else "")
def test_symbolic_and_array_evaluation_agree(name: str, correction: Correction) -> None:
    """Also outside the range and after several turns of an axis; with the operations of a tape."""
    from twin.compute.native.tape import Tape

    rng = np.random.default_rng(2)
    state = {axis: rng.uniform(low - 30, high + 30, 300) for axis, (low, high) in RANGES.items()}
    state["C"] = rng.uniform(-900, 900, 300)
    state |= {f"approach_{axis}": rng.choice([-1.0, 0.0, 1.0], 300) for axis in RANGES}
    symbols = {key: ca.SX.sym(key) for key in state}
    shifts = [correction.shift(axis, symbols) for axis in correction.axes]
    function = ca.Function("shift", list(symbols.values()), [ca.vertcat(*shifts)])
    there = Tape(function)([state[key] for key in symbols])
    # A grid is exact to EXACT_UM by specification; the others up to rounding.
    allowed = EXACT_UM if name == "grid" else 1e-8
    for k, axis in enumerate(correction.axes):
        assert np.abs(there[k] - correction.shift(axis, state)).max() <= allowed


def test_linuxcnc_as_its_manual_has_it(tmp_path: Path) -> None:
    """Examples of both types under [JOINT_n] COMP_FILE_TYPE, evaluated as in the source code."""
    head = "[TRAJ]\nCOORDINATES = X Y Z B C\nLINEAR_UNITS = mm\nANGULAR_UNITS = degree\n[JOINT_0]\nCOMP_FILE = x.comp\n"
    first = {
        "x.comp": "-1.000 -1.005 -0.995\n0.000 0.002 -0.003\n1.000 1.003 0.998\n",
        "a.ini": head + "COMP_FILE_TYPE = 0\n",
    }
    back = read_tables("linuxcnc", put(tmp_path / "0", first), MACHINE)
    up, down = (lambda q: {"X": q, "approach_X": 1.0}), (lambda q: {"X": q, "approach_X": -1.0})
    assert back.shift("X", up(-1.0)) == pytest.approx(5.0)
    assert back.shift("X", up(-0.5)) == pytest.approx(1.5)
    assert back.shift("X", down(0.0)) == pytest.approx(3.0)
    assert back.shift("X", up(7.0)) == pytest.approx(-3.0)
    assert back.shift("X", {"X": -1.0}) == pytest.approx(0.0)  # the mean of 5 and −5
    second = {
        "x.comp": "-1.000 0.005 -0.005\n0.000 0.002 -0.003\n1.000 0.003 -0.004\n",
        "a.ini": head + "COMP_FILE_TYPE = 1\n",
    }
    back = read_tables("linuxcnc", put(tmp_path / "1", second), MACHINE)
    assert back.shift("X", up(-1.0)) == pytest.approx(5.0)
    assert back.shift("X", down(0.5)) == pytest.approx(-3.5)


def test_siemens_as_its_manual_has_it(tmp_path: Path) -> None:
    """Sag of the foundation: ΔX1 = Z1 · β(X1), the second table a straight line, $AN_CEC_MULT_BY_TABLE[0] = 2 (K3, p. 252)."""
    text = """%_N_NC_CEC_INI
CHANDATA(1)
$AN_CEC[0,0]=0 ; sin β
$AN_CEC[0,1]=0.0001
$AN_CEC[0,2]=0.0003
$AN_CEC_INPUT_AXIS[0]=(X1)
$AN_CEC_OUTPUT_AXIS[0]=(X1)
$AN_CEC_STEP[0]=100
$AN_CEC_MIN[0]=0
$AN_CEC_MAX[0]=200
$AN_CEC_DIRECTION[0]=0
$AN_CEC_MULT_BY_TABLE[0]=2
$AN_CEC_IS_MODULO[0]=0
$AN_CEC[1,0]=-400
$AN_CEC[1,1]=0
$AN_CEC_INPUT_AXIS[1]=(AX3)
$AN_CEC_OUTPUT_AXIS[1]=(AX1)
$AN_CEC_STEP[1]=400
$AN_CEC_MIN[1]=-400
$AN_CEC_MAX[1]=0
M17
"""
    back = read_tables("siemens", put(tmp_path, {"cec.mpf": text}), MACHINE)
    assert back.axes == ("X",)
    assert back.shift("X", {"X": 150.0, "Z": -100.0}) == pytest.approx(0.0002 * -100.0 * 1e3)
    assert back.shift("X", {"X": 900.0, "Z": -100.0}) == pytest.approx(0.0003 * -100.0 * 1e3)


def test_isg_as_its_manual_has_it(tmp_path: Path) -> None:
    """The manual's component errors of X, levers by hand: at X 5 the mean of the rows, no lever at Y = Z = 0."""
    text = """X      EXX    EYX    EZX    EAX    EBX    ECX
0.0    0.02   0.01   0.07   0.00   0.0042 0.003
10.0   0.00   -0.1   0.01   0.00   0.0011 0.002
"""
    back = read_tables("isg", put(tmp_path, {"x.csv": text}), MACHINE)
    at = {"X": 5.0, "Y": 0.0, "Z": 0.0, "B": 0.0, "C": 0.0}
    assert [back.shift(axis, at) for axis in "XYZ"] == pytest.approx([-10.0, 45.0, -40.0])
    # ω × r = (−ωz·y + ωy·z, ωz·x − ωx·z, ωx·y − ωy·x) with r = (0, 100, −200) mm, ωy 2.65 mrad, ωz 2.5 mrad.
    assert back.shift("X", at | {"Y": 100.0, "Z": -200.0}) == pytest.approx(-10.0 + 250.0 + 530.0)
    two = "Z X EXX\n0 0 0.02\n0 10 0.01\n100 0 0.02\n100 10 0.01\n"
    with pytest.raises(InputError, match="two arguments") as caught:
        read_tables("isg", put(tmp_path, {"y.csv": two}), MACHINE)
    assert caught.value.line == 1


def test_heidenhain_screw_pitch_and_sag(tmp_path: Path) -> None:
    """The manual's machine: Z = F(Z), Y = F(Y), and Z = F(Y); a positive error is travel that is too long."""
    files = {
        "AXIS-Y.COM": "BEGIN AXIS-Y.COM MM\nNR AXISPOS BACKLASH Y Z\n0 -90 +0.020 +0.010 -0.030\n1 10 +0.000 +0.000 +0.010\n[END]\n",
        "AXIS-Z.COM": "BEGIN AXIS-Z.COM MM\nNR AXISPOS Z\n0 -200 +0.005\n1 0 -0.005\n[END]\n",
        "CONFIG.CMA": "BEGIN CONFIG.CMA MM\nNR ACTIVE Y Z\n0 - AXIS-Y AXIS-Y\n1 * AXIS-Y AXIS-Z\n[END]\n",
    }
    back = read_tables("heidenhain", put(tmp_path, files), MACHINE)
    at = {"Y": -40.0, "Z": -200.0}
    assert back.shift("Y", at | {"approach_Y": 1.0}) == pytest.approx(-5.0)
    assert back.shift("Y", at | {"approach_Y": -1.0}) == pytest.approx(-10.0)
    assert back.shift("Z", at) == pytest.approx(10.0 - 5.0)


def test_no_such_format(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such format"):
        read_tables("okuma", [tmp_path / "a"], MACHINE)


def test_more_points_than_linuxcnc_takes() -> None:
    at = tuple(float(q) for q in range(257))
    with pytest.raises(InputError, match="too many points") as caught:
        LinuxCnc().write(TableSum((ControlTerm("X", (ControlCurve("X", at, at),)),), MACHINE))
    assert caught.value.value == 257


def test_degrees() -> None:
    """Conversion of µrad to degrees and back."""
    assert ControlCurve("B", (0.0,), (1.0,)).along(0.0) * 1e-6 / DEG == pytest.approx(1.0 / URAD_A_DEG)


@pytest.mark.parametrize("start", [-180.0, 0.0, 30.0])
def test_a_curve_of_an_unlimited_axis_repeats_from_its_first_node_on(start: float) -> None:
    """Positions are wrapped into the turn that begins at the first node, for numbers and for expressions."""
    at = start + np.linspace(0.0, 360.0, 9)
    values = np.sin(np.radians(at)) + 0.2 * np.cos(np.radians(3.0 * at))
    curve = ControlCurve("C", tuple(at), tuple(values), period=360.0)
    q = np.concatenate([np.linspace(-800.0, 800.0, 77), [start - 1e-6, start, start + 359.999, start + 360.0]])
    expected = [np.interp(start + (x - start) % 360.0, at, values) for x in q]
    np.testing.assert_allclose(curve.along(q), expected, atol=1e-12)
    symbol = ca.SX.sym("q")
    evaluated = ca.Function("curve", [symbol], [curve.along(symbol)])
    np.testing.assert_allclose([float(evaluated(x)) for x in q], expected, atol=1e-12)


@pytest.mark.parametrize("direction", [-1, 0, 1])
def test_a_curve_of_one_direction(direction: int) -> None:
    """Whole in its own direction, nothing in the other, half where the direction is unknown."""
    curve = ControlCurve("X", (0.0, 100.0), (2.0, 6.0), direction=direction)  # type: ignore[arg-type]
    shares = [1.0, 1.0, 1.0] if direction == 0 else [0.0, 0.5, 1.0][::direction]
    for side, share in zip((-1.0, 0.0, 1.0), shares, strict=True):
        assert curve({"X": 25.0, "approach_X": side}) == share * 3.0
    assert curve({"X": 25.0}) == shares[1] * 3.0
