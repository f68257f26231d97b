"""Formats of control tables: what is written is read, and what is read is what the control does.

Every format is read a second time here by a few lines that share no code with `twin` and follow the control's own words (of LinuxCNC
its source).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from tests.truth.reference import about, dmu50_pose
from twin._common.errors import InputError
from twin._common.units import DEG
from twin.machine.control import Correction, Curve, Term, Terms, grid, heidenhain, isg, linuxcnc, read_tables, siemens
from twin.machine.control.geometry import Geometry
from twin.machine.machine import Machine

MACHINE = Machine.load("dmu50")
URAD_A_DEG = np.pi / 180.0 * 1e6
HALF_UM = {"linuxcnc": 0.0005, "heidenhain": 0.05, "siemens": 0.0005}
"""Half of the last written digit of mm."""
HALF_URAD = {"linuxcnc": 0.5e-6, "heidenhain": 0.5e-5, "siemens": 0.5e-6}
"""The same in degrees."""
RANGES = {"X": (0.0, 500.0), "Y": (0.0, 450.0), "Z": (-400.0, 0.0), "B": (0.0, 180.0), "C": (0.0, 360.0)}

values = st.floats(-150.0, 150.0).map(lambda value: round(value, 3))


def put(folder: Path, files: Mapping[str, str]) -> list[Path]:
    folder.mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text)
    return [folder / name for name in files]


@st.composite
def terms(draw: st.DrawFn, *, across: bool, products: bool, every_side: bool, wraps: bool) -> list[Term]:
    """Tables as a format may hold them: nodes of one axis in equal steps and the same in all its tables."""
    found = []
    for of, (low, high) in RANGES.items():
        count = draw(st.sampled_from((2, 3, 5, 6, 9)))
        at = tuple(float(q) for q in np.linspace(low, high, count))
        period = 360.0 if of == "C" and wraps else None
        moved = [of] if of in "BC" or not across else draw(st.lists(st.sampled_from("XYZ"), unique=True, max_size=3))
        for axis in moved:
            two = draw(st.booleans()) and (every_side or axis == of)
            for side in (1, -1) if two else (0,):
                curve = Curve(of, at, tuple(draw(st.lists(values, min_size=count, max_size=count))), period, side)
                found.append(Term(axis, (curve,)))
        if products and of in "XYZ" and draw(st.booleans()):
            by = draw(st.sampled_from([name for name in "XYZ" if name != of]))
            arm = Curve(by, RANGES[by], (draw(st.floats(-1.0, 1.0)), draw(st.floats(-1.0, 1.0))))
            curve = Curve(of, at, tuple(draw(st.lists(values, min_size=count, max_size=count))))
            found.append(Term(draw(st.sampled_from("XYZ")), (curve, arm)))
    return found


def close(kind: str, term: Term, back: Term) -> bool:
    """Whether a term came back to the digits written."""
    half = HALF_UM[kind] if term.axis in "XYZ" else HALF_URAD[kind] * URAD_A_DEG
    a, b = term.factors, back.factors
    return (
        (term.axis, [(f.of, f.direction) for f in a]) == (back.axis, [(f.of, f.direction) for f in b])
        and np.allclose(a[0].values, b[0].values, atol=half * (1 + 1e-6), rtol=0)
        and all(np.allclose(x.at, y.at, atol=1e-9, rtol=0) for x, y in zip(a, b, strict=True))
        and all(np.allclose(x.values, y.values, atol=1e-9, rtol=0) for x, y in zip(a[1:], b[1:], strict=True))
    )


def ordered(found: list[Term] | tuple[Term, ...]) -> list[Term]:
    return sorted(found, key=lambda term: (term.axis, [(f.of, f.direction) for f in term.factors]))


WRITERS: dict[str, Callable[..., dict[str, str]]] = {
    "linuxcnc": linuxcnc.write,
    "heidenhain": heidenhain.write,
    "siemens": siemens.write,
}
SHAPES = {
    "linuxcnc": {"across": False, "products": False, "every_side": False, "wraps": False},
    "heidenhain": {"across": True, "products": False, "every_side": False, "wraps": True},
    "siemens": {"across": True, "products": True, "every_side": True, "wraps": True},
}


@pytest.mark.parametrize("kind", WRITERS)
@settings(max_examples=15)
@given(data=st.data())
def test_what_is_written_is_read(kind: str, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    meant = data.draw(terms(**SHAPES[kind]))
    if not meant:
        return
    folder = tmp_path_factory.mktemp(kind)
    files = WRITERS[kind](meant, MACHINE, ("a note",))
    back = read_tables(kind, put(folder, files), MACHINE)
    assert isinstance(back, Terms)
    shown = ordered(back.terms)
    if len(shown) == len(meant):  # of LinuxCNC two directions that say the same are read as one table
        assert all(close(kind, a, b) for a, b in zip(ordered(meant), shown, strict=True))
    again = WRITERS[kind](back.terms, MACHINE, ("a note",))
    assert again == files
    rng = np.random.default_rng(3)
    state = {name: rng.uniform(low - 20, high + 20, 50) for name, (low, high) in RANGES.items()}
    state |= {f"approach_{name}": rng.choice([-1.0, 0.0, 1.0], 50) for name in RANGES}
    half = {name: (HALF_UM[kind] if name in "XYZ" else HALF_URAD[kind] * URAD_A_DEG) for name in RANGES}
    direct = Terms(meant, MACHINE)
    for axis in back.axes:
        # Digits of every table that moves the axis; of a product also those of its second table, 1e-9 of 150 µm.
        allowed = half[axis] * 1.01 * len(meant) + 1e-6
        assert np.abs(back.shift(axis, state) - direct.shift(axis, state)).max() <= allowed
        assert np.abs(BY_HAND[kind](folder, axis, state) - back.shift(axis, state)).max() <= 1e-6


def linuxcnc_by_hand(folder: Path, axis: str, state: Mapping[str, np.ndarray]) -> np.ndarray:
    """motor position − commanded position as `compute_screw_comp` has it."""
    ini = (folder / "joints.ini").read_text()
    letters = re.search(r"^COORDINATES = (.*)$", ini, re.M)[1].split()
    section = ini.split(f"[JOINT_{letters.index(axis)}]")[1].split("[")[0]
    file, kind = re.search(r"COMP_FILE = (\S+)", section)[1], re.search(r"COMP_FILE_TYPE = (\d)", section)[1]
    entries = []
    for line in (folder / file).read_text().splitlines():
        try:
            nominal, forward, reverse = map(float, line.split()[:3])
        except ValueError:
            break
        entries.append((nominal, nominal - forward, nominal - reverse) if kind == "0" else (nominal, forward, reverse))
    found = []
    for q, side in zip(state[axis], state[f"approach_{axis}"], strict=True):
        trims = []
        for column in (1, 2):
            before = [i for i, entry in enumerate(entries) if entry[0] <= q]
            if not before:
                trims.append(entries[0][column])
            elif before[-1] == len(entries) - 1:
                trims.append(entries[-1][column])
            else:
                a, b = entries[before[-1]], entries[before[-1] + 1]
                trims.append(a[column] + (b[column] - a[column]) / (b[0] - a[0]) * (q - a[0]))
        found.append({1.0: trims[0], -1.0: trims[1], 0.0: sum(trims) / 2}[side])
    return np.array(found) * (1e3 if axis in "XYZ" else URAD_A_DEG)


def heidenhain_by_hand(folder: Path, axis: str, state: Mapping[str, np.ndarray]) -> np.ndarray:
    """Minus the errors in the columns of the axis, over the axes the .CMA has them over."""
    rows = [line.split() for line in (folder / "CONFIG.CMA").read_text().splitlines()]
    total = np.zeros(len(state[axis]))
    for of, name in list(zip(rows[1], rows[2], strict=True))[2:]:
        lines = [line.split() for line in (folder / f"{name}.COM").read_text().split("[END]")[0].splitlines()[1:]]
        table = {key: np.array([float(line[i]) for line in lines[1:]]) for i, key in enumerate(lines[0])}
        q = np.mod(state[of], 360.0) if of == "C" else state[of]
        if axis not in table:
            continue
        forward = np.interp(q, table["AXISPOS"], table[axis])
        backward = np.interp(q, table["AXISPOS"], table["BACKLASH"]) if axis == of and "BACKLASH" in table else forward
        side = state[f"approach_{of}"]
        total -= np.where(side > 0, forward, np.where(side < 0, backward, 0.5 * (forward + backward)))
    return total * (1e3 if axis in "XYZ" else URAD_A_DEG)


def siemens_by_hand(folder: Path, axis: str, state: Mapping[str, np.ndarray]) -> np.ndarray:
    """Sum of the tables of the axis and of the products; a table that multiplies another does not count itself."""
    names = [name for name in state if not name.startswith("approach_")]  # AX1, AX2, …
    text = (folder / "cec.mpf").read_text()
    single = dict(re.findall(r"^\$AN_CEC_(\w+\[\d+\])=\(?([^)\n]+)\)?$", text, re.M))
    points: dict[int, list[float]] = {}
    for table, _, value in re.findall(r"^\$AN_CEC\[(\d+),(\d+)\]=(\S+)$", text, re.M):
        points.setdefault(int(table), []).append(float(value))

    def looked_up(t: int) -> np.ndarray:
        low, high = float(single[f"MIN[{t}]"]), float(single[f"MAX[{t}]"])
        of = names[int(single[f"INPUT_AXIS[{t}]"][2:]) - 1]
        q = state[of]
        if single[f"IS_MODULO[{t}]"] == "1":
            q = low + np.mod(q - low, high - low)
        value = np.interp(q, np.linspace(low, high, len(points[t])), points[t])
        direction, side = int(single[f"DIRECTION[{t}]"]), state[f"approach_{of}"]
        return value if direction == 0 else value * np.where(side == direction, 1.0, np.where(side == 0, 0.5, 0.0))

    multiplied = {int(single[f"MULT_BY_TABLE[{t}]"]) - 1 for t in points} - {-1}
    total = np.zeros(len(state[axis]))
    for t in points:
        if t in multiplied or names[int(single[f"OUTPUT_AXIS[{t}]"][2:]) - 1] != axis:
            continue
        by = int(single[f"MULT_BY_TABLE[{t}]"])
        total += looked_up(t) * (looked_up(by - 1) if by else 1.0)
    return total * (1e3 if axis in "XYZ" else URAD_A_DEG)


def isg_by_hand(folder: Path, axis: str, state: Mapping[str, np.ndarray]) -> np.ndarray:
    """The DMU 50 with the component errors of the file, and what X, Y, Z have to move for the point to stay."""
    text = (folder / "volcomp.csv").read_text()
    length = float(re.search(r"tool length (\S+) mm", text)[1])
    blocks = [block.split() for block in re.sub(r"//.*", "", text).split("#")]
    tables = {}
    for words in blocks[1:]:
        head = [word for word in words if re.match(r"[A-Z]", word)]
        tables[words[0]] = (head[1:], np.array(words[len(head) :], dtype=float).reshape(-1, len(head)))
    found = []
    for i in range(len(state["X"])):
        q = np.array([state[name][i] for name in "XYZBC"])
        errors = {name: np.zeros(6) for name in ("X", "Y", "Z", "B", "C", "L_B", "L_C")}
        for name, (columns, rows) in tables.items():
            place = q["XYZBC".index(name)]
            place = np.mod(place, 360.0) if name == "C" else place
            for k, column in enumerate(columns, start=1):
                errors[name]["XYZABC".index(column[1])] = np.interp(place, rows[:, 0], rows[:, k])
        # The frame of B is turned by 45° about x; the file has the machine's directions.
        tilt = about(0, np.pi / 4)[:3, :3]
        errors["B"] = np.concatenate([tilt.T @ errors["B"][:3], tilt.T @ errors["B"][3:]])
        none = {name: np.zeros(6) for name in errors}
        b, c = np.radians(q[3:])
        real, meant = (dmu50_pose([*q[:3], b, c], one, length) for one in (errors, none))
        work = tilt @ about(2, b)[:3, :3] @ tilt.T @ about(2, -c)[:3, :3]
        found.append(-(work @ (real - meant)[:3, 3])["XYZ".index(axis)] * 1e3)
    return np.array(found)


BY_HAND = {
    "linuxcnc": linuxcnc_by_hand,
    "heidenhain": heidenhain_by_hand,
    "siemens": siemens_by_hand,
    "isg": isg_by_hand,
}


@settings(max_examples=6)
@given(data=st.data())
def test_component_errors(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    errors = []
    for name, (low, high) in RANGES.items():
        at = tuple(np.linspace(low, high, data.draw(st.integers(2, 7))).round(4))
        scale = [20.0] * 3 + [80.0] * 3
        curves = {
            i: Curve(name, at, tuple(rng.normal(0, scale[i], len(at)).round(3)), 360.0 if name == "C" else None)
            for i in data.draw(st.lists(st.integers(0, 5), unique=True, min_size=1))
        }
        errors.append(isg.AxisErrors(name, curves))
    geometry = Geometry(MACHINE, 137.5)
    files = isg.write(errors, geometry, ("a note",))
    folder = tmp_path_factory.mktemp("isg")
    back = read_tables("isg", put(folder, files), MACHINE)
    assert isinstance(back, isg.Volumetric)
    for a, b in zip(errors, back.errors, strict=True):
        assert sorted(a.curves) == sorted(b.curves)
        for i in a.curves:
            assert np.allclose(
                a.curves[i].values, b.curves[i].values, atol=0.00051, rtol=0
            )  # half of 1e-6 mm, 1e-9 rad
    assert isg.write(back.errors, back.geometry, ("a note",)) == files
    state = {name: rng.uniform(low, high, 12) for name, (low, high) in RANGES.items()}
    for axis in "XYZ":
        # Exactly turned there, to first order here: 300 µrad · 100 µm, 300 µrad² · 1 m / 2, and 1e-4 of 0.2 mm.
        assert np.abs(BY_HAND["isg"](folder, axis, state) - back.shift(axis, state)).max() < 0.15


@settings(max_examples=10)
@given(data=st.data())
def test_grid(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    counts = [data.draw(st.integers(2, 5)) for _ in range(3)]
    at = tuple(tuple(np.linspace(*RANGES[name], n).round(4)) for name, n in zip("XYZ", counts, strict=True))
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    meant = grid.Grid(("X", "Y", "Z"), at, rng.normal(0, 40, (*counts, 3)))
    files = grid.write(meant, ("a note",))
    folder = tmp_path_factory.mktemp("grid")
    back = read_tables("grid", put(folder, files), MACHINE)
    assert isinstance(back, grid.Grid)
    assert np.abs(back.values - meant.values).max() <= 0.51e-4  # half of the last digit, µm
    assert grid.write(back, ("a note",)) == files
    rows = np.loadtxt(folder / "grid.csv", delimiter=",", comments=("#", "X"))
    by_hand = RegularGridInterpolator(
        [np.unique(rows[:, i]) for i in range(3)], rows[:, 3:].reshape(*counts, 3), bounds_error=False
    )
    state = {name: rng.uniform(low - 20, high + 20, 200) for name, (low, high) in RANGES.items()}
    inside = np.stack([np.clip(state[name], *RANGES[name]) for name in "XYZ"], axis=1)
    for k, axis in enumerate("XYZ"):
        assert np.allclose(back.shift(axis, state), by_hand(inside)[:, k], atol=1e-9)


def examples() -> list[tuple[str, Correction]]:
    rng = np.random.default_rng(11)

    def curve(of: str, n: int, side: int = 0) -> Curve:
        low, high = RANGES[of]
        return Curve(
            of, tuple(np.linspace(low, high, n)), tuple(rng.normal(0, 30, n)), 360.0 if of == "C" else None, side
        )

    found = Terms(
        [
            Term("X", (curve("X", 12),)),
            Term("Y", (curve("X", 5, 1),)),
            Term("Y", (curve("X", 7, -1),)),
            Term("Z", (curve("Y", 6), Curve("Z", (-400.0, 0.0), (-1.0, 1.0)))),
            Term("C", (curve("C", 13),)),
            Term("B", (Curve("B", (90.0,), (4.0,)),)),
        ],
        MACHINE,
    )
    errors = [isg.AxisErrors(name, {i: curve(name, 6) for i in range(6)}) for name in RANGES]
    at = tuple(tuple(np.linspace(*RANGES[name], 6)) for name in "XYZ")
    return [
        ("terms", found),
        ("isg", isg.Volumetric(errors, Geometry(MACHINE, 80.0))),
        ("grid", grid.Grid(("X", "Y", "Z"), at, rng.normal(0, 30, (6, 6, 6, 3)))),
    ]


@pytest.mark.parametrize(("name", "correction"), examples(), ids=lambda one: one if isinstance(one, str) else "")
def test_the_expression_is_what_arrays_say(name: str, correction: Correction) -> None:
    """Also beyond the ends, and where an axis has turned more than once; from the operations a tape knows."""
    from twin.compute.native.tape import Tape

    rng = np.random.default_rng(2)
    state = {axis: rng.uniform(low - 30, high + 30, 300) for axis, (low, high) in RANGES.items()}
    state["C"] = rng.uniform(-900, 900, 300)
    state |= {f"approach_{axis}": rng.choice([-1.0, 0.0, 1.0], 300) for axis in RANGES}
    symbols = {key: ca.SX.sym(key) for key in state}
    shifts = [correction.shift(axis, symbols) for axis in correction.axes]
    function = ca.Function("shift", list(symbols.values()), [ca.vertcat(*shifts)])
    there = Tape(function)([state[key] for key in symbols])
    # A grid is exact to EXACT_UM by its own word; the others but for rounding.
    allowed = grid.EXACT_UM if name == "grid" else 1e-8
    for k, axis in enumerate(correction.axes):
        assert np.abs(there[k] - correction.shift(axis, state)).max() <= allowed


def test_linuxcnc_as_its_manual_has_it(tmp_path: Path) -> None:
    """The examples of both types under [JOINT_n] COMP_FILE_TYPE, looked up as the source does it."""
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
    """Sag of a foundation: ΔX1 = Z1 · β(X1), the second table a straight line, $AN_CEC_MULT_BY_TABLE[0] = 2 (K3, p. 252)."""
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
    """The example of component errors of X; levers by hand: at X 5 the file's mean, the nose itself no lever at Y = Z = 0."""
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


GOOD = {
    "linuxcnc": {
        "joints.ini": "[TRAJ]\nCOORDINATES = X Y Z B C\nLINEAR_UNITS = mm\nANGULAR_UNITS = degree\n[JOINT_0]\nCOMP_FILE = X.comp\n"
        "COMP_FILE_TYPE = 0\n",
        "X.comp": "0 0.001 0.001\n100 100.002 100.002\n200 200.001 200.001\n",
    },
    "heidenhain": {
        "CONFIG.CMA": "BEGIN CONFIG.CMA MM\nNR ACTIVE X\n0 * X_CORR\n[END]\n",
        "X_CORR.COM": "BEGIN X_CORR.COM MM\nNR AXISPOS X Y\n0 0 +0.001 +0.002\n1 100 +0.002 +0.001\n[END]\n",
    },
    "siemens": {
        "cec.mpf": "$AN_CEC[0,0]=0.01\n$AN_CEC[0,1]=0.02\n$AN_CEC_INPUT_AXIS[0]=(AX1)\n$AN_CEC_OUTPUT_AXIS[0]=(AX2)\n"
        "$AN_CEC_STEP[0]=100\n$AN_CEC_MIN[0]=0\n$AN_CEC_MAX[0]=100\n$AN_CEC_MULT_BY_TABLE[0]=0\nM17\n"
    },
    "isg": {"volcomp.csv": "P0X P0Y P0Z\n0 0 0\n#\nX EXX EYX\n0 0.001 0.002\n100 0.002 0.001\n"},
    "grid": {
        "grid.csv": "X_mm,Y_mm,Z_mm,dX_um,dY_um,dZ_um\n"
        + "".join(f"{x},{y},{z},1,2,3\n" for x in (0, 9) for y in (0, 9) for z in (-9, 0))
    },
}
BAD = [
    ("linuxcnc", "X.comp", "100 100.002", "# the middle\n100 100.002", 2, "LinuxCNC stops there"),
    ("linuxcnc", "X.comp", "100 100.002", "\n100 100.002", 2, "LinuxCNC stops there"),
    ("linuxcnc", "X.comp", "200 200.001", "90 200.001", 3, "do not rise"),
    ("linuxcnc", "X.comp", "100.002 100", "1e999 100", 2, "no number"),
    ("linuxcnc", "joints.ini", "COMP_FILE_TYPE = 0", "COMP_FILE_TYPE = 2", 7, "COMP_FILE_TYPE"),
    ("linuxcnc", "joints.ini", "LINEAR_UNITS = mm", "LINEAR_UNITS = inch", 3, "LINEAR_UNITS"),
    ("linuxcnc", "joints.ini", "COMP_FILE = X.comp", "COMP_FILE = Y.comp", 6, "not given"),
    ("linuxcnc", "joints.ini", "X Y Z B C", "V Y Z B C", 6, "no such axis"),
    ("heidenhain", "X_CORR.COM", "+0.002 +0.001", "+0.002", 4, "cells"),
    ("heidenhain", "X_CORR.COM", "1 100", "1 0", 4, "do not rise"),
    ("heidenhain", "X_CORR.COM", "X Y", "X W", 2, "no such axis"),
    ("heidenhain", "X_CORR.COM", "+0.001 +0.002", "+0.001 ja", 3, "no number"),
    ("heidenhain", "X_CORR.COM", "COM MM", "COM INCH", 1, "not in mm"),
    ("heidenhain", "CONFIG.CMA", "* X_CORR", "- X_CORR", None, r"lines with \*"),
    ("heidenhain", "CONFIG.CMA", "* X_CORR", "* Q_CORR", 3, "not given"),
    ("siemens", "cec.mpf", "$AN_CEC[0,1]=0.02\n", "", 1, "points"),
    ("siemens", "cec.mpf", "STEP[0]=100", "STEP[0]=30", 5, "does not divide"),
    ("siemens", "cec.mpf", "STEP[0]=100", "STEP[0]=1e-308", 5, "does not divide"),
    ("siemens", "cec.mpf", "STEP[0]=100", "STEP[0]=1e-300", 1, "points"),
    ("siemens", "cec.mpf", "$AN_CEC_MAX[0]=100\n", "", 1, "lacks"),
    ("siemens", "cec.mpf", "(AX2)", "(AX9)", 4, "no such axis"),
    ("siemens", "cec.mpf", "BY_TABLE[0]=0", "BY_TABLE[0]=7", 8, "no such table"),
    ("siemens", "cec.mpf", "M17", "G0 X100", 9, "no line of a compensation table"),
    ("siemens", "cec.mpf", "[0,1]=0.02", "[0,1]=$R1", 2, "no number"),
    ("siemens", "cec.mpf", "[0,1]=0.02", "[0,0]=0.02", 2, "written twice"),
    ("isg", "volcomp.csv", "EYX", "EYY", 4, "a column of a block"),
    ("isg", "volcomp.csv", "100 0.002", "100", 6, "cells"),
    ("isg", "volcomp.csv", "100 0.002", "0 0.002", 6, "do not rise"),
    ("isg", "volcomp.csv", "0 0 0\n", "0 0 12\n", 2, "P0Z is not"),
    ("isg", "volcomp.csv", "P0X P0Y", "C0Y P0Y", 1, "not read"),
    ("grid", "grid.csv", "9,9,0,1", "9,9,0,x", 9, "no number"),
    ("grid", "grid.csv", "9,9,0,1", "9,0,0,1", 9, "given twice"),
    ("grid", "grid.csv", "9,9,0,1,2,3\n", "", None, "a point is missing"),
    ("grid", "grid.csv", "dX_um", "eX_um", None, "columns"),
]


@pytest.mark.parametrize("kind", GOOD)
def test_what_the_refusals_are_made_of_is_read(kind: str, tmp_path: Path) -> None:
    assert read_tables(kind, put(tmp_path, GOOD[kind]), MACHINE).axes


@pytest.mark.parametrize(("kind", "file", "old", "new", "line", "what"), BAD)
def test_refused(kind: str, file: str, old: str, new: str, line: int | None, what: str, tmp_path: Path) -> None:
    assert old in GOOD[kind][file]
    files = GOOD[kind] | {file: GOOD[kind][file].replace(old, new, 1)}
    with pytest.raises(InputError, match=what) as caught:
        read_tables(kind, put(tmp_path, files), MACHINE)
    assert caught.value.line == line
    assert Path(str(caught.value.file)).name == file


def test_no_such_format(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such format"):
        read_tables("fanuc", [tmp_path / "a"], MACHINE)


def test_more_points_than_linuxcnc_takes() -> None:
    at = tuple(float(q) for q in range(257))
    with pytest.raises(InputError, match="too many points") as caught:
        linuxcnc.write([Term("X", (Curve("X", at, at),))], MACHINE)
    assert caught.value.value == 257


def test_degrees() -> None:
    """A µrad in degrees, the other way round."""
    assert Curve("B", (0.0,), (1.0,)).along(0.0) * 1e-6 / DEG == pytest.approx(1.0 / URAD_A_DEG)
