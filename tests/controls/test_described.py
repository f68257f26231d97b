"""Kinematics of controls, read as answers: judged by LinuxCNC's own modules, by vectors in this file, and by hand-written machines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from tests.linuxcnc.kins import forward, needs_modules
from tests.machine.test_description import DMU50, SLIDES, TRUNNION, changed, commands, made, poses
from tests.truth.rotary_table import turned
from twin._common.errors import InputError
from twin.controls.described import StatedKinematics
from twin.controls.kinematics import kinematics_formats

ROT_POINT = {"x-rot-point": 5.0, "y-rot-point": -7.0, "z-rot-point": 40.0}
TABLE = {"X": 37.0, "Y": -12.0, "Z": -450.0}


def stated(folder: Path, text: str, name: str = "control.txt") -> StatedKinematics:
    (folder / name).write_text(text)
    return StatedKinematics.load([folder / name])


def bare(tool: str, work: str, **ranges: Any) -> dict[str, Any]:
    """Return answers without anything about the rotary axes but their ranges."""
    axes = {**SLIDES, **{name: {"range": reach} for name, reach in ranges.items()}}
    return {"name": "bare", "tool": tool.split(), "work": work.split(), "table": TABLE, "axes": axes}


@needs_modules
@pytest.mark.parametrize(
    ("module", "pins", "tool", "work", "joints"),
    [
        ("xyzac-trt-kins", ROT_POINT | {"y-offset": 12.5, "z-offset": 3}, "X Y Z", "A C", "XYZAC"),
        ("xyzbc-trt-kins", ROT_POINT | {"x-offset": 12.5, "z-offset": 3}, "Z", "Y X B C", "XYZBC"),
        ("5axiskins", {"pivot-length": 181.25}, "X Y Z C B", "", "XYZBC"),
        ("maxkins", {"pivot-length": 181.25}, "X Z B", "Y C", "XYZABC"),
    ],
)  # fmt: skip
def test_linuxcnc_is_read_as_its_modules_compute(
    module: str, pins: dict[str, float], tool: str, work: str, joints: str, tmp_path: Path
) -> None:
    hal = f"loadrt {module}\n" + "".join(f"setp {module}.{name} {value}\n" for name, value in pins.items())
    ini = f"[KINS]\nKINEMATICS = {module} sparm=identityfirst\n[AXIS_B]\nMIN_LIMIT = -95\nMAX_LIMIT = 95\n"
    (tmp_path / "a.hal").write_text(hal)
    (tmp_path / "a.ini").write_text(ini)
    found = StatedKinematics.load([tmp_path / "a.ini", tmp_path / "a.hal"])
    data = bare(tool, work, A=[-95, 95], C=[-200, 200])
    data["axes"].pop("A" if "B" in joints else "B", None)
    machine = made(tmp_path, found.completed(data))
    q = commands(machine)
    if (
        module == "maxkins"
    ):  # its formula is that of a rigid machine only where one rotary axis is at zero; see its `unchecked`
        q[::2, machine.names.index("B")] = 0.0
        q[1::2, machine.names.index("C")] = 0.0
        assert any("rigid" in text for text in found.unchecked)
    columns = [q[:, machine.names.index(name)] if name in machine.names else np.zeros(len(q)) for name in joints]
    world = forward(module, pins, np.array([*columns, *([0 * columns[0]] * (9 - len(columns)))]).T)
    tip, axis = poses(machine, q, 0.0)
    np.testing.assert_allclose(tip + list(TABLE.values()), world[:, :3], rtol=0, atol=1e-8)
    assert np.ptp(axis, axis=0).max() > 0.5
    assert max(value for row in found.differences(machine) for value in row[1:3]) < 1e-9


def test_pins_of_signals(tmp_path: Path) -> None:
    """`net` joins a pin to a signal, and `sets` gives the signal its value, as in the configurations that come with LinuxCNC."""
    ini = "[KINS]\nKINEMATICS = xyzac-trt-kins\n[HAL]\nHALCMD = net :y xyzac-trt-kins.y-offset gui.y-offset\n"
    ini += "HALCMD = net :tool xyzac-trt-kins.tool-offset\n{}HALCMD = setp xyzac-trt-kins.z-rot-point 5\n"
    found = stated(tmp_path, ini.format("HALCMD = sets :y 20\n"))
    np.testing.assert_array_equal(found.axes[0].point, [0, 20, 5])
    with pytest.raises(InputError, match=r"y-offset is that of the signal :y.*`sets :y …`"):
        stated(tmp_path, ini.format(""))


@needs_modules
def test_maxkins_is_no_rigid_machine_with_both_axes_away_from_zero() -> None:
    """The statement in `unchecked`, proven: the distance between two points on the workpiece changes."""
    joints = np.array([[0, 0, 0, 0, 90, c, 0, 0, 0] for c in (0.0, 90.0)], dtype=float)
    tips = forward("maxkins", {"pivot-length": 100}, joints)[:, :3]
    expected = tips[0] @ turned([0, 0, 1], np.radians(90.0)).T  # the table turns below a tool that stands still
    assert np.linalg.norm(tips[1] - expected) > 100.0


HEAD = "$MC_TRAFO_TYPE_1={}\n" + "".join(
    f"$MC_TRAFO5_{name}_1[{i}]={value}\n"
    for name, vector in {
        "BASE_TOOL": (1, 2, 93.8),
        "JOINT_OFFSET": (0, 172, 172),
        "JOINT_OFFSET_PART": (300, 250, -390),
    }.items()
    for i, value in enumerate(vector)
)
NUMBERS = """N24100 $MC_TRAFO_TYPE_1=56
MD24550[0] = 1
MD24550[1] = 2
N24550 $MC_TRAFO5_BASE_TOOL_1[2]=93.8 ; mm
N24558 $MC_TRAFO5_JOINT_OFFSET_PART_1[0]=300
N24558 $MC_TRAFO5_JOINT_OFFSET_PART_1[1]=250
N24558 $MC_TRAFO5_JOINT_OFFSET_PART_1[2]=-390
N24570 $MC_TRAFO5_AXIS1_1[1]=1
N24572 $MC_TRAFO5_AXIS2_1[2]=1
N24520 $MC_TRAFO5_ROT_SIGN_IS_PLUS_1[0]=FALSE
"""


def axes_of(vectors: dict[int, tuple[float, float, float]]) -> str:
    return "".join(
        f"$MC_TRAFO5_AXIS{n}_1[{i}]={value}\n" for n, vector in vectors.items() for i, value in enumerate(vector)
    )


def tip_of_head(q: np.ndarray, lines: list[tuple[Any, Any]], length: float) -> np.ndarray:
    """Return the tip of a head with two axes (direction, point from the nose; nearest to the bed first) from X Y Z and two angles."""
    tip = np.array([0.0, 0.0, -length])
    for (direction, point), angle in zip(reversed(lines), reversed(q[3:]), strict=True):
        tip = np.array(point) + turned(np.array(direction), np.radians(angle)) @ (tip - point)
    return q[:3] + tip


def test_sinumerik_head_of_the_commissioning_manual(tmp_path: Path) -> None:
    """The cardanic head HEAD_2 of the manual: V1 0 1 0, I2 0 172 172, V2 0 -1 1 (45°), I3 0 0 93.8 (here with an offset of 1, 2)."""
    found = stated(tmp_path, HEAD.format(24) + axes_of({1: (0, 1, 0), 2: (0, -1, 1)}))
    machine = made(tmp_path, found.completed(bare("X Y Z B C", "", B=[-180, 180], C=[0, 180])))
    q = commands(machine, 20)
    tip, _ = poses(machine, q, 55.0)
    lines = [((0, 1, 0), (1, 174, 265.8)), ((0, -1, 1), (1, 2, 93.8))]
    expected = np.array([tip_of_head(one, lines, 55.0) for one in q])
    np.testing.assert_allclose(tip + list(TABLE.values()), expected, rtol=0, atol=1e-9)


def test_sinumerik_head_and_table_by_numbers(tmp_path: Path) -> None:
    found = stated(tmp_path, NUMBERS)
    data = found.completed(bare("X Y Z B", "C", B=[-90, 90], C="unlimited"))
    assert data["axes"]["B"]["about"] == "0 -1 0" and data["axes"]["B"]["at"] == "nose 1 2 93.8"
    assert data["axes"]["C"]["about"] == "0 0 1" and data["axes"]["C"]["at"] == "machine 300 250 -390"


def carrier(kind: str, fields: dict[int, object], n: int = 1) -> str:
    """Return a swivel data record: `$TC_CARR<field>[n]`, with the first field of a vector given."""
    rows = [f'$TC_CARR23[{n}]="{kind}"']
    for first, value in fields.items():
        values = value if isinstance(value, tuple) else (value,)
        rows += [f"$TC_CARR{first + i}[{n}]={one}" for i, one in enumerate(values)]
    return "\n".join(rows) + "\n"


HEAD_2 = {7: (0, 1, 0), 10: (0, -1, 1), 4: (0, 172, 172), 15: (0, 0, 93.8), 55: (1, 2, 0), 21: "B", 22: "C"}
HEAD_2 |= {30: -180, 32: 180, 31: 0, 33: 180}


@pytest.mark.parametrize("transformation", ["", "$MC_TRAFO_TYPE_1=72\n$MC_TRAFO5_TCARR_NO_1=2\n"])
def test_sinumerik_tool_carrier(transformation: str, tmp_path: Path) -> None:
    """The same head as a swivel data record, one offset of it as fine offset; type 72 says which of two records."""
    other = carrier("P", {7: (1, 0, 0), 10: (0, 0, 1)}) if transformation else ""
    found = stated(tmp_path, transformation + other + carrier("T", HEAD_2, 2))
    machine = made(tmp_path, found.completed(bare("X Y Z B C", "")))
    assert [(axis.lower, axis.upper) for axis in machine.axes[3:]] == [(-180.0, 180.0), (0.0, 180.0)]
    q = commands(machine, 20)
    tip, _ = poses(machine, q, 55.0)
    lines = [((0, 1, 0), (1, 174, 265.8)), ((0, -1, 1), (1, 2, 93.8))]
    expected = np.array([tip_of_head(one, lines, 55.0) for one in q])
    np.testing.assert_allclose(tip + list(TABLE.values()), expected, rtol=0, atol=1e-9)


def test_sinumerik_table_and_mixed_tool_carriers(tmp_path: Path) -> None:
    """The correspondence to the machine data of types 40 and 56 (manual, p. 572)."""
    turned_axes = {7: (1, 0, 0), 10: (0, 0, 1), 21: "A", 22: "C", 4: (300, 250, -400), 15: (0, 5, 60), 18: (1, 2, 3)}
    axes = stated(tmp_path, carrier("P", turned_axes)).completed(bare("X Y Z", "A C", A=[-90, 90], C="unlimited"))[
        "axes"
    ]
    assert (axes["A"]["at"], axes["C"]["at"]) == ("machine 300 250 -400", "machine 300 255 -340")
    mixed = {7: (0, -1, 0), 10: (0, 0, 1), 21: "B", 22: "C", 1: (-1, -2, -93.8), 4: (1, 2, 93.8), 15: (300, 250, -390)}
    data = stated(tmp_path, carrier("m", mixed)).completed(bare("X Y Z B", "C", B=[-90, 90], C="unlimited"))
    same = stated(tmp_path, NUMBERS).completed(bare("X Y Z B", "C", B=[-90, 90], C="unlimited"))
    assert data["axes"] == same["axes"]


@pytest.mark.parametrize(
    ("kind", "tool", "work", "about"),
    [(21, "X Y Z C B", "", "001 010"), (35, "X Y Z", "B C", "010 001"), (48, "X Y Z A", "B", "100 010")],
)
def test_sinumerik_types_that_state_their_axes(kind: int, tool: str, work: str, about: str, tmp_path: Path) -> None:
    names = [name for name in (*tool.split(), *work.split()) if name in "ABC"]
    ranges = {name: [-90, 90] for name in names}
    data = stated(tmp_path, HEAD.format(kind)).completed(bare(tool, work, **ranges))
    assert [data["axes"][name]["about"].replace(" ", "") for name in names] == about.split()
    wrong = ("X Y Z B C", "") if tool.endswith("C B") else (tool, work.translate(str.maketrans("BC", "CB")))
    with pytest.raises(InputError, match="contradicts the control"):
        stated(tmp_path, HEAD.format(kind)).completed(bare(*wrong, B=[-90, 90], C=[-90, 90], A=[-90, 90]))


FANUC = "N19680Q1L1P{}\nN19681Q1L1P4\nN19682Q1L1P3\nN19684Q1L1P0\nN19686Q1L1P5\nN19687Q1L1P{}\nN19688Q1L1P{}\nN19689Q1L1P{}\n"
FANUC += "N19666Q1L1P150.\nN19697Q1L1P3\nN19700Q1L1P10.\nN19701Q1L1P20.\nN19702Q1L1P-30.5\nN19709P1.\nN19711 P50.\nN19713P-25.\n"


def test_fanuc_heads(tmp_path: Path) -> None:
    """Type 2, C and B: D at the tool holder offset, from there to E on B, and to F on C; B inclined in the plane YZ by 45°."""
    for code, angle, line in ((2, 0, (0, 1, 0)), (5, 45, (0, 1, 1))):
        found = stated(tmp_path, FANUC.format(2, code, angle, 0))
        machine = made(tmp_path, found.completed(bare("X Y Z C B", "", C=[-180, 180], B=[-90, 90])))
        q = commands(machine, 20)
        tip, _ = poses(machine, q, 55.0)
        lines = [((0, 0, 1), (1, -25, 200)), (line, (1, 0, 200))]
        expected = np.array([tip_of_head(one[[0, 1, 2, 4, 3]], lines, 55.0) for one in q])
        np.testing.assert_allclose(tip + list(TABLE.values()), expected, rtol=0, atol=1e-9)
    mixed = stated(tmp_path, FANUC.format(21, 3, 0, 1).replace("N19682Q1L1P3", "N19682Q1L1P2")).completed(
        bare("X Y Z B", "C", B=[-90, 90], C="unlimited")
    )["axes"]
    assert (mixed["B"]["about"], mixed["B"]["at"]) == ("0 1 0", "nose 1 0 200")
    assert (mixed["C"]["about"], mixed["C"]["at"]) == ("0 0 1", "machine 10 20 -30.5")


def test_heidenhain_head_and_table(tmp_path: Path) -> None:
    text = "NR KEY AXIS COORD\n0 ToolAxis Z\n1 Trans Z 140\n2 Trans Y 30\n3 Trans A -45\n4 MachAxis B\n5 Trans A 45\n"
    text += "6 Trans Y -30\n7 Trans Z -140\n8 MachAxis Z\n9 MachAxis Y\n10 MachAxis X\n11 Trans X 300\n12 Trans Y 250\n13 MachAxis C\n"
    axes = stated(tmp_path, text).completed(bare("X Y Z B", "C", B=[-90, 180], C="unlimited"))["axes"]
    assert axes["B"]["at"] == "nose 0 30 140" and axes["C"]["at"] == "machine 300 250 0"
    np.testing.assert_allclose(
        [float(word) for word in axes["B"]["about"].split()], [0, 0.5**0.5, -(0.5**0.5)], atol=1e-15
    )


@pytest.mark.parametrize("data", [TRUNNION, DMU50])
def test_files_that_twin_writes_for_a_control_describe_the_same_machine(data: dict[str, Any], tmp_path: Path) -> None:
    machine = made(tmp_path, data)
    read = 0
    for form in kinematics_formats():
        try:
            text = form.write(form.nominal(machine), machine)
        except InputError:
            continue
        found = stated(tmp_path, text)
        for _, angle, away, _ in found.differences(machine):
            assert angle < 1e-3 and away < 1e-4  # Fanuc: angles with three decimals
        assert found.unchecked
        fresh = changed(data, **{f"{name}__at": None for name in data["work"] if name in "ABC"})
        again = made(tmp_path, found.completed(changed(fresh, B__about=None) if "B" in fresh["axes"] else fresh))
        for mine, theirs in zip(poses(again, commands(machine)), poses(machine, commands(machine)), strict=True):
            np.testing.assert_allclose(mine, theirs, rtol=0, atol=0.01)
        read += 1
    assert read >= 4


def test_a_kinematic_chain_gives_both_sides(tmp_path: Path) -> None:
    machine = twin.Machine.load("trunnion_ac")
    form = next(one for one in kinematics_formats() if one.name == "siemens-chain")
    found = stated(tmp_path, form.write(form.nominal(machine), machine))
    data = {key: value for key, value in TRUNNION.items() if key not in ("tool", "work")}
    data["axes"] = {name: {"range": one["range"]} for name, one in data["axes"].items()}
    completed = found.completed(data)
    assert (completed["tool"], completed["work"]) == (["X", "Z"], ["Y", "A", "C"])
    with pytest.raises(
        InputError, match=r"`tool` contradicts the control: SINUMERIK, kinematic chain has X Z there: 'Z'"
    ):
        found.completed({**data, "tool": ["Z"], "work": ["X", "Y", "A", "C"]})


def test_a_control_that_contradicts_an_answer_names_it(tmp_path: Path) -> None:
    hal = (
        "setp xyzac-trt-kins.x-rot-point 300\nsetp xyzac-trt-kins.y-rot-point 250\nsetp xyzac-trt-kins.z-rot-point {}\n"
    )
    hal += "setp xyzac-trt-kins.conventional-directions {}\n"
    assert stated(tmp_path, hal.format(-390, 1)).completed(TRUNNION)["axes"]["A"]["at"] == "machine 300 250 -390"
    for z, sense, answer, words in (
        (-389, 1, {}, ["`axes.A.at` contradicts the control", "xyzac-trt-kins", "-389"]),
        (-390, 0, {"A__positive": "iso"}, ["`axes.A.positive` contradicts"]),
        (-390, 1, {"A__about": "1 0.01 0"}, ["`axes.A.about` contradicts"]),
        (-390, 1, {"work": ["Y", "C", "A"]}, ["`work` contradicts the control", "A C"]),
        (-390, 1, {"work": ["Y", "C"], "A__range": [-1, 1]}, ["`work` contradicts"]),
    ):
        with pytest.raises(InputError) as refused:
            stated(tmp_path, hal.format(z, sense)).completed(changed(TRUNNION, **answer))
        assert all(word in str(refused.value) for word in words), refused.value
    ini = "[KINS]\nKINEMATICS = xyzac-trt-kins\n[AXIS_A]\nMIN_LIMIT = -100\nMAX_LIMIT = 30\n"
    with pytest.raises(InputError, match=r"`axes.A.range` contradicts"):
        stated(tmp_path, ini).completed(TRUNNION)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("hello\n", ["no kinematics of a control"]),
        (HEAD.format(257), ["another type", "24", "56 or 72", "257"]),
        (HEAD.format(72), ["no tool carrier", "$TC_CARR…[1]"]),
        (carrier("T", HEAD_2) + carrier("T", HEAD_2, 2), ["several tool carriers", "1, 2"]),
        (carrier("X", HEAD_2), ["$TC_CARR23", "T, P or M", "control.txt:1"]),
        (carrier("T", HEAD_2 | {24: 5}), ["zero of a rotary axis is shifted", "control.txt:"]),
        (HEAD.format(24), ["AXIS1", "missing or zero"]),
        (HEAD.format(24) + axes_of({1: (0, 0, 0), 2: (0, 1, 0)}), ["missing or zero"]),
        (HEAD.format(24) + "$MC_TRAFO5_BASE_TOOL_1[2]=94\n", ["two values", "control.txt:"]),
        (HEAD.format(24).replace("93.8", "93,8") + axes_of({1: (1, 0, 0), 2: (0, 1, 0)}), ["not a number", "93,8"]),
        (NUMBERS.replace("MD24550[0]", "N24510 $MC_TRAFO5_ROT_AX_OFFSET_1[0]"), ["MD24510", "control.txt:2"]),
        (NUMBERS + "N24574 $MC_TRAFO5_BASE_ORIENT_1[0]=1\n", ["MD24574", "control.txt:"]),
        (FANUC.format(5, 2, 0, 0), ["19680", "2, 12 or 21"]),
        (FANUC.format(2, 9, 0, 0), ["19687", "1 to 6"]),
        (FANUC.format(2, 2, 0, 0).replace("N19697Q1L1P3", "N19697Q1L1P1"), ["19697", "+Z"]),
        ("0 MachAxis Z\n", ["no rotary axis"]),
        ("0 MachAxis B\n1 Trans Q 3\n", ["control.txt:2", "not a row"]),
        ("KINEMATICS = trivkins\n[KINS]\nKINEMATICS = trivkins\n", ["another kind", "trivkins"]),
        ("setp maxkins.pivot-length x\n", ["not a number"]),
        ("[KINS]\nKINEMATICS = maxkins\n", ["maxkins.pivot-length", "HAL"]),
        ('$NK_NAME[0]="A"\n', ["$NT_T_CHAIN_LAST_ELEM"]),
        ('$NK_NAME[0]="A"\n$NT_T_CHAIN_LAST_ELEM[1]="B"\n', ["broken or closed"]),
    ],
)  # fmt: skip
def test_files_that_cannot_be_read_are_refused(text: str, words: list[str], tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        stated(tmp_path, text)
    assert all(word in str(refused.value) for word in words), refused.value
