"""Heights of every cycle before and after compensation, on a machine whose error is the same everywhere.

There the control must execute the same motions by the original and by the output, each shifted by the same correction. Judges: the
interpreter of LinuxCNC for the cycles that it knows, else the strokes as the manuals' figures show them: Fanuc Series 30i operator's
manual ("Canned cycle for drilling"), SINUMERIK 840D sl "Cycles" (CYCLE81 to 89, 840), TNC 640 "Programming of machining cycles".
"""

from __future__ import annotations

import re
from pathlib import Path
from random import Random
from types import MappingProxyType

import numpy as np
import pytest

from tests.nc import rs274
from twin._common.errors import InputError
from twin.compensation import Compensator
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.motion_curve import Curve
from twin.nc import DIALECTS
from twin.nc.iso import cycles

ISO, PLAIN = DIALECTS[0], DIALECTS[1]
ERROR_MM = np.array([0.040, -0.060, 0.090])
PLANES = {17: "XYZ", 18: "XZY", 19: "YZX"}
START = {"X": 300.0, "Y": 200.0, "Z": -200.0}
INCREMENT_MM = 2e-3  # rounding of the words, in inches too
SINUMERIK_ENDS = {
    # name: further arguments
    "CYCLE81": "",
    "CYCLE82": ",0.5",
    "CYCLE83": ",,8,0,0,0,1,{vari}",
    "CYCLE84": ",0,3,,1.5,90,100,100",
    "CYCLE85": ",0,80,200",
    "CYCLE86": ",0.5,3,1,1,1,45",
    "CYCLE87": ",3",
    "CYCLE88": ",0.5,3",
    "CYCLE89": ",0.5",
    "CYCLE840": ",0,4,3,1,,1.5",
}
Motion = tuple[str, tuple[float, float, float], str]
"""A motion: rapid or feed, its end, and the words of a cycle that the control executes there."""


@pytest.fixture(scope="module")
def everywhere(dmu50: Machine) -> Compensator:
    curves = {}
    for name, size in zip(("E_XX", "E_YY", "E_ZZ"), ERROR_MM, strict=True):
        axis = dmu50.by_name[name[3:]]
        assert axis.lower is not None and axis.upper is not None
        curves[name] = Curve(name, "um", (axis.lower, axis.upper), "power", (1e3 * float(size),))
    empty: MappingProxyType[str, float] = MappingProxyType({})
    return Compensator(dmu50, Calibration(dmu50, "the same everywhere", MappingProxyType(curves), empty, empty))


def check_same(before: list[Motion], after: list[Motion], depth: int, text: str, written: str) -> None:
    """Check that two executions are the same but for one shift by the error, and that their cycles have the same words."""
    before, after = _merged(before, depth), _merged(after, depth)
    shown = "\n".join(f"{a}   {b}" for a, b in zip(before, after, strict=False))
    assert len(before) == len(after), f"{len(before)} and {len(after)} motions\n{text}\n{written}\n{shown}"
    off = np.array([b[1] for b in after]) - np.array([a[1] for a in before]) + ERROR_MM
    assert np.abs(off).max() < INCREMENT_MM, f"{off}\n{text}\n{written}\n{shown}"
    assert [a[2] for a in before] == [b[2] for b in after], f"{text}\n{written}\n{shown}"


def _merged(motions: list[Motion], depth: int) -> list[Motion]:
    """Return motions without those that go nowhere; a way up of several parts counts as one."""
    kept: list[Motion] = []
    for kind, end, words in motions:
        if kept and np.abs(np.subtract(end, kept[-1][1])).max() < 1e-6 and words in ("", kept[-1][2]):
            continue
        if len(kept) > 1 and not (words or kept[-1][2]):
            last, way = np.subtract(kept[-1][1], kept[-2][1]), np.subtract(end, kept[-1][1])
            rising = last[depth] > 0.0 and way[depth] > 0.0
            if rising and np.abs(np.delete(last, depth)).max() < 1e-6 and np.abs(np.delete(way, depth)).max() < 1e-6:
                kept.pop()
        kept.append((kind, end, words))
    return kept


class Series:
    """Holes of one cycle of Fanuc or LinuxCNC, drawn at random."""

    def __init__(self, code: str, seed: int, *, linuxcnc: bool) -> None:
        rng = self.rng = Random(f"{code} {seed}")
        self.code, self.plane = code, rng.choice([17, 17, 18, 19])
        if linuxcnc and code in ("74", "84"):
            self.plane = 17  # LinuxCNC 2.9 taps along wrong axes in the others; twin refuses it
        self.names = PLANES[self.plane]
        self.relative = rng.random() < 0.4 and code != "87"
        self.unit = 25.4 if rng.random() < 0.2 else 1.0
        self.level = rng.choice(["G98", "G99"])
        self.count = 1
        below = linuxcnc and rng.random() < 0.3
        self.top = rng.uniform(2.0, 9.0) if below else -rng.uniform(3.0, 9.0)
        spindle = "M4" if code == "74" else "M3"
        first = ["#<a>=1"] if linuxcnc else []
        lines = [f"G90 G21 G17 G94 G40 G49 G80 F100 S100 {spindle}", *first, f"G{self.plane}"]
        lines += ["G0 X300. Y200. Z-200. B0. C0."]
        lines += ["G20"] if self.unit != 1.0 else []
        repeats = rng.choice(["", "", f" {'L' if linuxcnc else 'K'}3"]) if code not in ("74", "76") else ""
        head = f"{'G91 ' if self.relative else ''}{self.level} G{code}"
        lines.append(f"{head} {self.place()} {self.heights()}{self.words()} F{rng.choice(['90', '120'])}{repeats}")
        for _ in range(rng.randint(1, 4)):
            lines.append(self.next(linuxcnc))
        lines += ["G80", "G90 G21", "G0 X310. Y210. Z-190.", "M2", ""]
        self.text = "\n".join(lines)

    def number(self, value: float) -> str:
        return f"{value / self.unit:.{4 if self.unit != 1.0 else 3}f}"

    def place(self) -> str:
        self.count += 1
        way = {self.names[0]: 3.0 * self.count, self.names[1]: 2.0 * self.count}
        return " ".join(
            f"{axis}{self.number(step + (0.0 if self.relative else START[axis]))}" for axis, step in way.items()
        )

    def heights(self) -> str:
        depth = self.names[2]
        bottom = -self.rng.uniform(18.0, 30.0)
        if self.code == "87":
            self.top, bottom = -self.rng.uniform(18.0, 30.0), -self.rng.uniform(4.0, 9.0)
        if self.relative:
            return f"{depth}{self.number(bottom)} R{self.number(self.top)}"
        return f"{depth}{self.number(START[depth] + bottom)} R{self.number(START[depth] + self.top)}"

    def words(self) -> str:
        draw = self.rng.random()
        if self.code in ("82", "86", "88", "89"):
            return " P0.5"
        if self.code in ("73", "83"):
            return f" Q{self.number(8.0)}"
        if self.code in ("76", "87"):
            return " Q.1 P500" if draw < 0.5 else " I.1 J-.2"
        return ""

    def next(self, linuxcnc: bool) -> str:
        """Return a further block: a place, other heights, another level, the cycle once more, or none."""
        kind = self.rng.choice(["place", "place", "heights", "level", "again", "alone"])
        if kind == "heights":
            self.top = self.rng.uniform(-9.0, self.rng.choice([9.0, self.top]) if linuxcnc else self.top)
            return f"{self.place()} {self.heights()}"
        if kind == "level" and (linuxcnc or self.level == "G98"):
            self.level = "G99" if self.level == "G98" else "G98"
            return self.level + (f" {self.place()}" if self.rng.random() < 0.7 else "")
        if kind == "again":
            return f"G{self.code} {self.place()} {self.heights()}{self.words()}"
        return "M8" if kind == "alone" else self.place()


def executed(text: str, folder: Path) -> list[Motion] | str:
    """Return the motions of LinuxCNC, or its message."""
    path = folder / "part.ngc"
    path.write_text(text)
    reading = rs274.read(path, folder)
    return reading.refusal or [("", motion.event.end[:3], "") for motion in reading.motions]


@rs274.needed
@pytest.mark.sample(10)
@pytest.mark.parametrize("seed", range(24))
@pytest.mark.parametrize("code", ["73", "74", "81", "82", "83", "84", "85", "86", "89"])
def test_heights_of_linuxcnc(
    everywhere: Compensator, code: str, seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cycles, "CLEARANCE_MM", rs274.PECK_MM)
    series = Series(code, seed, linuxcnc=True)
    meant = executed(series.text, tmp_path)
    try:
        written = everywhere.compensate(ISO.read(series.text.encode(), "part.ngc"), ISO).text
    except InputError as error:
        assert "in the block after G90 or G91" in str(error) or isinstance(meant, str), f"{error}\n{series.text}"
        return
    done = executed(written, tmp_path)
    assert not isinstance(meant, str) and not isinstance(done, str), f"{meant} {done}\n{series.text}\n{written}"
    check_same(meant, done, "XYZ".index(series.names[2]), series.text, written)


class Control:
    """A control of Fanuc or SINUMERIK that executes straight moves and cycles; positions in mm."""

    WORD = re.compile(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))")
    CYCLES = frozenset({"73", "74", "76", *map(str, range(81, 90))})

    def __init__(self) -> None:
        self.at = dict.fromkeys("XYZ", 0.0)
        self.motions: list[Motion] = []
        self.relative, self.plane, self.code, self.to_initial, self.unit = False, 17, "", True, 1.0
        self.heights: dict[str, float] = {}
        self.others: dict[str, str] = {}
        self.initial, self.motion = 0.0, "0"
        self.called = ""

    @property
    def depth(self) -> str:
        return PLANES[self.plane][2]

    def go(self, kind: str, words: str = "", **to: float) -> None:
        self.at |= to
        self.motions.append((kind, (self.at["X"], self.at["Y"], self.at["Z"]), words))

    def run(self, text: str) -> list[Motion]:
        for raw in text.splitlines():
            line = re.sub(r"^\(.*\)\s*$|;.*", "", raw)
            call = re.search(r"(MCALL\s*)?(CYCLE\d+)\((.*)\)", line)
            if line.strip() == "MCALL":
                self.called = ""
            elif call and call[1]:
                self.called = call[0]
            elif call:
                self.of_sinumerik(call[2], call[3].split(","))
            elif line.strip():
                self.block(line)
        return self.motions

    def block(self, line: str) -> None:
        words = self.WORD.findall(line)
        codes = [value.lstrip("0") or "0" for letter, value in words if letter == "G"]
        values = {letter: float(value) for letter, value in words if letter not in "GM"}
        for code in codes:
            self.relative = {"90": False, "91": True}.get(code, self.relative)
            self.unit = {"20": 25.4, "70": 25.4, "21": 1.0, "71": 1.0}.get(code, self.unit)
            self.to_initial = {"98": True, "99": False}.get(code, self.to_initial)
            self.plane = int(code) if code in ("17", "18", "19") else self.plane
            if code in ("0", "1"):
                self.motion, self.code = code, ""
            if code == "80":
                self.code = ""
            if code in self.CYCLES:
                if not self.code:
                    self.initial, self.heights, self.others = self.at[self.depth], {}, {}
                self.code = code
        axes = {axis: values[axis] * self.unit for axis in "XYZ" if axis in values}
        if self.code and (axes or "R" in values):
            self.drill(axes, values, words)
        elif axes and "4" not in codes:
            self.go("R" if self.motion == "0" else "F", **self.targets(axes))
            if self.called:
                name, arguments = re.findall(r"(CYCLE\d+)\((.*)\)", self.called)[0]
                self.of_sinumerik(name, arguments.split(","))

    def targets(self, axes: dict[str, float]) -> dict[str, float]:
        return {axis: value + (self.at[axis] if self.relative else 0.0) for axis, value in axes.items()}

    def drill(self, axes: dict[str, float], values: dict[str, float], words: list[tuple[str, str]]) -> None:
        """Execute a block of a cycle of Fanuc."""
        if "R" in values:
            self.heights["R"] = values["R"] * self.unit + (self.initial if self.relative else 0.0)
        if self.depth in axes:
            self.heights["Z"] = axes.pop(self.depth) + (self.heights["R"] if self.relative else 0.0)
        self.others |= {letter: value for letter, value in words if letter in "PQIJ"}
        top, bottom = self.heights["R"], self.heights["Z"]
        level = self.initial if self.to_initial or self.code == "87" else top
        own = self.code in ("74", "76", "84", "86", "87", "88")
        said = f"{self.code} {sorted(self.others.items())}" if own else ""
        for _ in range(int(values.get("K", 1))):
            self.go("R", **self.targets(axes))
            self.go("R", **{self.depth: top})
            if self.code in ("73", "83"):
                self.peck(top, top, bottom, float(self.others["Q"]) * self.unit, full=self.code == "83")
            self.go("F", said, **{self.depth: bottom})
            if self.code in ("85", "89"):
                self.go("F", **{self.depth: top})
            self.go("R", **{self.depth: level})

    def peck(self, top: float, reached: float, bottom: float, step: float, *, full: bool) -> None:
        """Drill in steps from a height, first from another one."""
        while reached - step > bottom + 1e-9:
            reached -= step
            self.go("F", **{self.depth: reached})
            if full:
                self.go("R", **{self.depth: top})
            self.go("R", **{self.depth: min(reached + cycles.CLEARANCE_MM, top)})

    def of_sinumerik(self, name: str, texts: list[str]) -> None:
        """Execute a cycle where the tool stands."""
        texts = [text.strip() for text in texts] + [""] * 20
        retract, reference, distance, depth, relative = (
            (float(text) * self.unit if text else 0.0) for text in texts[:5]
        )
        bottom = depth if texts[3] else reference - relative
        top, expanded = reference + distance, name in ("CYCLE81", "CYCLE82", "CYCLE83", "CYCLE85", "CYCLE89")
        said = "" if expanded else f"{name} {texts[2]} {texts[5:]} {reference - bottom:.1f}"
        self.go("R", **{self.depth: top})
        if name == "CYCLE83":
            self.peck(top, reference, bottom, float(texts[6]) * self.unit, full=texts[11] == "1")
        self.go("F", said, **{self.depth: bottom})
        if name in ("CYCLE85", "CYCLE89"):
            self.go("F", **{self.depth: top})
        self.go("R", **{self.depth: retract})


@pytest.mark.sample(10)
@pytest.mark.parametrize("seed", range(24))
@pytest.mark.parametrize("code", ["73", "74", "76", "81", "82", "83", "84", "85", "86", "87", "88", "89"])
def test_heights_of_fanuc(everywhere: Compensator, code: str, seed: int) -> None:
    series = Series(code, seed, linuxcnc=False)
    written = everywhere.compensate(ISO.read(series.text.encode(), "O1234"), ISO).text
    check_same(Control().run(series.text), Control().run(written), "XYZ".index(series.names[2]), series.text, written)


@pytest.mark.sample(10)
@pytest.mark.parametrize("seed", range(24))
@pytest.mark.parametrize("name", SINUMERIK_ENDS)
def test_heights_of_sinumerik(everywhere: Compensator, name: str, seed: int) -> None:
    rng = Random(f"{name} {seed}")
    plane, unit = rng.choice([17, 17, 18, 19]), 25.4 if rng.random() < 0.2 else 1.0
    names = PLANES[plane]
    zero = START[names[2]]
    reference, distance, deep = zero - rng.uniform(4, 9), rng.uniform(0, 2), rng.uniform(11, 30)
    retract = reference + distance + rng.choice([0.0, rng.uniform(0, 9)])
    depth = f",{(reference - deep) / unit:.4f}," if rng.random() < 0.5 else f",,{deep / unit:.4f}"
    heights = ",".join(f"{value / unit:.4f}" for value in (retract + 0.01, reference, distance))
    end = SINUMERIK_ENDS[name].format(vari=rng.choice("01")).replace(",8,", f",{8 / unit:.4f},")
    cycle = f"{name}({heights}{depth}{end})"
    lines = ["G90 G71 G17 G94 F100 S100 M3", f"G{plane}", "G0 X300. Y200. Z-200. B0. C0."]
    lines += ["G70"] if unit != 1.0 else []
    modal = rng.random() < 0.7
    lines += [f"MCALL {cycle}"] if modal else []
    for i in range(rng.randint(1, 4)):
        relative = rng.random() < 0.3
        way = {axis: (i + 2) * step for axis, step in zip(names, (3.0, 2.0), strict=False)}
        zeros = START if not relative else dict.fromkeys("XYZ", 0.0)
        words = " ".join(f"{axis}{(zeros[axis] + step) / unit:.4f}" for axis, step in way.items())
        lines.append(f"G9{1 if relative else 0} {'G0 ' if rng.random() < 0.4 else ''}{words}")
        lines += [] if modal else [cycle]
    lines += ["MCALL"] if modal else []
    text = "\n".join([*lines, "G90 G71", "G0 X310. Y210. Z-190.", "M30", ""])
    written = everywhere.compensate(ISO.read(text.encode(), "part.mpf"), ISO).text
    check_same(Control().run(text), Control().run(written), "XYZ".index(names[2]), text, written)


def run_plain(text: str) -> list[Motion]:
    """Execute straight moves and calls of cycles in plain language; positions in mm."""
    at, motions, parameters = dict.fromkeys("XYZ", 0.0), list[Motion](), dict[str, str]()
    unit, modal = 25.4 if "INCH" in text.splitlines()[0] else 1.0, False
    older = ""

    def go(words: str = "", **to: float) -> None:
        at.update(to)
        motions.append(("", (at["X"], at["Y"], at["Z"]), words))

    for raw in text.splitlines():
        line = re.sub(r"^\d+ |;.*|~", "", raw).strip()
        if line.startswith("CYCL DEF"):
            name, part = line.split()[2].split(".") if "." in line.split()[2] else (line.split()[2], "0")
            older = older if part != "0" else ""
            number, parameters = name, {} if part == "0" else parameters
            older += line if len(name) < 3 else ""
        parameters |= dict(re.findall(r"(Q\d+)\s*=\s*([-+.\d]+)", line))
        if line.startswith("L "):
            for sign, axis, value in re.findall(r"\b(I?)([XYZ])([-+.\d]+)", line):
                at[axis] = float(value) * unit + (at[axis] if sign else 0.0)
            go()
        modal = (modal or "M89" in line) and "M99" not in line
        if "M99" not in line and not line.startswith("CYCL CALL") and not (modal and line.startswith("L ")):
            continue
        if older:
            start = at["Z"]
            go(older, Z=start - 10.0 * unit)
            go(Z=start)
            continue
        surface, clearance = float(parameters["Q203"]) * unit, float(parameters["Q200"]) * unit
        go(Z=surface + clearance)
        others = sorted((name, value) for name, value in parameters.items() if name not in ("Q203", "Q204"))
        go(f"{number} {others}", Z=surface + float(parameters.get("Q201", -7.0)) * unit)
        go(Z=surface + max(clearance, float(parameters.get("Q204", 0.0)) * unit))
    return motions


@pytest.mark.sample(10)
@pytest.mark.parametrize("seed", range(24))
@pytest.mark.parametrize("number", [*range(200, 210), 240, 241, 1, 2, 17, 18])
def test_heights_of_plain_language(everywhere: Compensator, number: int, seed: int) -> None:
    rng = Random(f"{number} {seed}")
    unit = 25.4 if rng.random() < 0.25 else 1.0
    places = rng.choice([3, 4])
    head = f"BEGIN PGM A {'INCH' if unit != 1.0 else 'MM'}"

    def size(value: float, decimals: int = places) -> str:
        return f"{value / unit:+.{decimals}f}"

    lines = [head, "TOOL CALL 5 Z S5000", f"L X{size(300)} Y{size(200)} Z{size(-200)} B+0 C+0 R0 FMAX M3"]
    surface = -200.0 - rng.uniform(5.0, 30.0) if number > 18 and rng.random() < 0.8 else -190.0
    if number > 18:
        lines += [f"CYCL DEF {number} NAME ~", f"Q200={size(rng.uniform(1, 6))} ~", f"Q201={size(-10)} ~"]
        second = rng.choice(["", f"Q204={size(rng.uniform(0, 3))} ~", f"Q204={size(rng.uniform(6, 30))} ~"])
        lines += ["Q206=250 ~", *([second] if second else []), f"Q203={size(surface)}"]
    else:
        lines += [f"CYCL DEF {number}.0 NAME", f"CYCL DEF {number}.1 SET UP {size(2)}"]
        lines += [f"CYCL DEF {number}.2 DEPTH {size(-8)}"]
    way = rng.choice(["M99", "CALL", "M89"])
    for i in range(rng.randint(1, 4)):
        relative = rng.random() < 0.4
        words = f"IX{size(4)} IY{size(-3)}" if relative else f"X{size(304 + 5 * i)} Y{size(203 + 3 * i)}"
        words += f" IZ{size(rng.uniform(-1, 3))}" if rng.random() < 0.3 else ""
        lines.append(
            f"L {words} FMAX{'' if way == 'CALL' else ' M89' if way == 'M89' and i == 0 else ' M99' if way == 'M99' else ''}"
        )
        lines += ["CYCL CALL M8"] if way == "CALL" else []
    lines += ["L IX+1 FMAX M99"] if way == "M89" else []
    lines += [f"L IZ{size(1)} FMAX", f"L X{size(310)} Y{size(210)} Z{size(-190)} FMAX", "M30", "END PGM A MM"]
    text = "".join(f"{i} {line}\n" for i, line in enumerate(lines))
    written = everywhere.compensate(PLAIN.read(text.encode(), "part.h"), PLAIN).text
    check_same(run_plain(text), run_plain(written), 2, text, written)
