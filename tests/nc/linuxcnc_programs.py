"""Random programs in the language of LinuxCNC, written without a path of their own: its interpreter says what they mean.

Statements are those of the G-code, O-code and parameter references of LinuxCNC's manual. Some programs are no good on purpose: what
the interpreter refuses ends the comparison there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from random import Random

PLANES = {17: "XYIJZ", 18: "ZXKIY", 19: "YZJKX"}
CYCLES = ("81", "82", "83", "73", "85", "89", "81")
NAMED = ("#<a>", "#<_glob>", "#<Depth of cut>", "#<_Wide>", "#101", "#102", "#31", "#[100+1]")
FUNCTIONS = ("SIN", "COS", "TAN", "ABS", "ROUND", "FIX", "FUP", "SQRT", "EXP", "LN", "ASIN", "ACOS")
OPERATORS = ("+", "-", "*", "/", "**", "MOD", "EQ", "NE", "GT", "GE", "LT", "LE", "AND", "OR", "XOR")
TOOLS = "T1 P1 Z1.5\nT2 P2 Z2.5\nT7 P3 Z-3.25\n"
RECURSION = [
    *("o900 sub", "#<own>=[#1*2]", "o901 if [#1 GT 0]", "o900 call [#1-1] [#<own>]", "o901 endif"),
    *("G1 X#<own> Y#2", "o900 endsub"),
]
"""A subprogram that calls itself, with a named parameter at each level."""
PARAMETERS = "".join(
    f"{5221 + 20 * system + axis} {value:.6f}\n"
    for system in range(9)
    for axis, value in zip((0, 1, 2, 4, 5), (system, 2 * system, -system, 0.5 * system, -3 * system), strict=True)
)


@dataclass
class ControlProgram:
    """A program that grows by random statements.

    Attributes:
        rng: source of every choice.
        kinds: names of the kinds of statements, each as often as it stands there.
        lines: the program so far.
        subs: definitions of subprograms, in front of it.
    """

    rng: Random
    kinds: tuple[str, ...]
    lines: list[str] = field(default_factory=list)
    subs: list[str] = field(default_factory=list)
    plane: int = 17
    known: list[str] = field(default_factory=list)
    count: int = 0

    def __post_init__(self) -> None:
        self.lines += ["G90 G21 G17 G94 G98 G40 G49 G54 G91.1 F500", "G0 X250 Y200 Z-150 B10 C20"]

    @property
    def text(self) -> str:
        return "\n".join([*self.lines[:2], *self.subs, *self.lines[2:], "M2", ""])

    def grow(self, statements: int) -> ControlProgram:
        """Add statements and return the program."""
        for _ in range(statements):
            getattr(self, self.rng.choice(self.kinds))()
        return self

    # ------------------------------------------------------------------ numbers

    def number(self, low: float, high: float) -> str:
        """Return a number in one of the forms that programs have."""
        text = f"{self.rng.uniform(low, high):.{self.rng.choice([0, 1, 3, 4])}f}"
        return text + self.rng.choice(["", "."]) if "." not in text else text.rstrip("0")

    def expression(self, depth: int = 1) -> str:
        """Return an expression between brackets, of numbers and parameters."""
        rng = self.rng
        if depth == 0 or rng.random() < 0.2:
            choice = rng.random()
            if choice < 0.4 and self.known:
                return rng.choice(["", "", "-"]) + rng.choice(self.known)
            return rng.choice(["", "", "", "-"]) + self.number(0.0, 20.0)
        kind = rng.random()
        if kind < 0.25:
            inner = self.expression(depth - 1)
            return f"{rng.choice(FUNCTIONS)}[{inner}]"
        if kind < 0.3:
            return f"ATAN[{self.expression(depth - 1)}]/[{self.expression(depth - 1)}]"
        parts = [self.expression(depth - 1)]
        for _ in range(rng.choice([1, 1, 2, 3])):
            parts += [rng.choice(OPERATORS[:6] if rng.random() < 0.85 else OPERATORS), self.expression(depth - 1)]
        return f"[{' '.join(parts)}]"

    def value(self, low: float, high: float) -> str:
        """Return a number, a parameter or an expression."""
        kind = self.rng.random()
        if "assign" not in self.kinds or kind < 0.6:
            return self.number(low, high)
        if kind < 0.8 and self.known:
            return self.rng.choice(["", "-"]) + self.rng.choice(self.known)
        return f"[{self.expression(self.rng.choice([1, 1, 2]))}]"

    def words(self, axes: str, low: float = -50.0, high: float = 250.0) -> str:
        rng = self.rng
        chosen = sorted(rng.sample(axes, rng.randint(1, min(3, len(axes)))))
        return rng.choice([" ", "", "  "]).join(f"{axis}{self.value(low, high)}" for axis in chosen)

    # ------------------------------------------------------------------ statements

    def line(self) -> None:
        """A straight move."""
        rng = self.rng
        head = rng.choice(["", "G0 ", "G1 ", "G01", "g1 ", "G91 G1 ", "G90 ", "G90 G0 "])
        self.lines.append(head + self.words("XYZBC") + rng.choice(["", "", " F300", " (X9)", " ; G2"]))

    def arc(self) -> None:
        """An arc, helix or circle in one of the planes; its words are relative."""
        rng = self.rng
        a, b, i, j, c = PLANES[self.plane]
        radius, first = rng.uniform(2.0, 40.0), rng.uniform(0.0, 2.0 * math.pi)
        sweep = rng.choice([rng.uniform(0.1, 3.0), rng.uniform(3.3, 6.0)])
        clockwise = rng.random() < 0.5
        centre = (-radius * math.cos(first), -radius * math.sin(first))
        last = first - sweep if clockwise else first + sweep
        end = (centre[0] + radius * math.cos(last), centre[1] + radius * math.sin(last))
        words = [f"G{2 if clockwise else 3}"]
        full = rng.random() < 0.2
        if not full:
            words += [f"{a}{end[0]:.6f}", f"{b}{end[1]:.6f}"]
        if rng.random() < 0.4:
            words.append(f"{c}{self.number(-9.0, 9.0)}")
        if rng.random() < 0.2:
            words.append(f"C{self.number(-9.0, 9.0)}")
        if full or rng.random() < 0.6:
            words += [f"{i}{centre[0]:.6f}", f"{j}{centre[1]:.6f}"]
        else:
            words.append(f"R{(radius if sweep < math.pi else -radius):.6f}")
        if rng.random() < 0.3:
            words.append(f"P{rng.choice([1, 2, 3, 7])}")
        mode = rng.choice(["G91 ", "G91 G91.1 "])
        self.lines.append(f"{mode}{' '.join(words)}{rng.choice(['', ' G90'])}".replace("G91 G2", "G91G2"))
        if self.lines[-1].endswith(" G90"):
            # Two words of one group are refused; the mode is set back in a block of its own.
            self.lines[-1:] = [self.lines[-1][:-4], "G90"]

    def mode(self) -> None:
        """A block of modal words."""
        rng = self.rng
        if rng.random() < 0.5:
            self.plane = rng.choice([17, 18, 19])
            self.lines.append(f"G{self.plane}")
        else:
            words = [
                "G90",
                "G91",
                "G20",
                "G21",
                "G98",
                "G99",
                "G61",
                "G64 P0.02",
                "G80",
                "G40",
                "G97 S100",
                "G90.1",
                "G91.1",
            ]
            self.lines.append(rng.choice(words))

    def feed(self) -> None:
        """Inverse time, or a feed a revolution."""
        mode = self.rng.choice(["G93", "G95", "G94"])
        self.lines.append(f"S100 M3 {mode} G1 {self.words('XYZ')} F{self.number(1, 9)}")
        if mode != "G94":
            self.lines.append(f"{self.words('XYZB')} F{self.number(1, 9)}")
        self.lines.append("G94 F500")

    def polar(self) -> None:
        """Distances and angles from the zero of the coordinates, also of holes; and places of an arc."""
        rng = self.rng
        words = [f"@{self.number(1, 90)}", f"^{self.value(-200, 200)}", f"@{self.number(1, 9)} ^{self.value(-99, 99)}"]
        head = rng.choice(["G1 ", "", "G0 ", "G91 G1 ", "G90 ", "G91 "])
        self.lines.append(head + rng.choice(words) + rng.choice(["", " Z3", "", " C5"]))
        if rng.random() < 0.3:
            self.lines += ["G90 G17", "G0 X30 Y10 Z50", f"G2 @{self.number(25, 40)} ^{self.number(0, 90)} R90"]
        if rng.random() < 0.4:
            level, relative = rng.choice(["G98", "G99"]), rng.random() < 0.5
            self.lines += ["G80 G17 G90", "G0 X40 Y20 Z50"]
            heights = "R-10 Z-30" if relative else "R40 Z-3"
            repeats = f" L{rng.choice([1, 2, 5])}" if rng.random() < 0.7 else ""
            self.lines.append(f"{'G91 ' if relative else ''}{level} G81 {rng.choice(words)} {heights}{repeats}")
            self.lines += [rng.choice(words) + rng.choice(["", "", " L3"]) for _ in range(rng.choice([0, 1, 2]))]
            self.lines += ["G80", "G90"]

    def saved(self) -> None:
        """Modal words saved and restored."""
        rng = self.rng
        self.lines += ["M70", rng.choice(["G91", "G20", "G18", "G93", "G99", "G91 G20", "G55"])]
        self.lines += [f"G1 {self.words('XYZ')} F200"] if rng.random() < 0.7 else []
        self.lines += [
            rng.choice(["M72", "M72", "M71", "M73", "M72\nG1 X7\nM72", "M72 G1 X5"]),
            f"G1 {self.words('XYZ')} F100",
        ]
        self.lines += ["G94 G17 F500"]
        self.plane = 17

    def offset(self) -> None:
        """A work offset, or another shift of the coordinates."""
        rng = self.rng
        system = rng.choice(["54", "55", "56", "57", "58", "59", "59.1", "59.2", "59.3"])
        words = [f"G{system}", f"G{system} G0 {self.words('XYZBC')}", f"G{system}"]
        if rng.random() < 0.4:
            words = [
                f"G92 {self.words('XYZBC')}",
                *("G92.1", "G92.2", "G92.3", f"G52 {self.words('XYZ')}", f"G92 {self.words('XYZ')}"),
                f"G10 L2 P{rng.randint(0, 3)} {self.words('XYZBC')}",
                f"G10 L2 P{rng.randint(1, 3)} R{self.number(-90, 90)} {self.words('XY')}",
                f"G10 L20 P{rng.randint(0, 3)} {self.words('XYZBC')}",
                f"G10 L1 P{rng.choice([1, 2])} Z{self.number(0, 9)}",
                f"#{rng.choice([5221, 5243, 5211])}={self.number(0, 9)}",
            ]
        self.lines.append(rng.choice(words))

    def turned(self) -> None:
        """A turned work offset."""
        self.lines.append(f"G10 L2 P1 R{self.number(-90, 90)}")

    def tool(self) -> None:
        """A tool or a length."""
        words = ["T1 M6", "T2 M6", "T7 M6 G43", "G43", "G43 H1", "G43 H2", "G43 H7 Z5", "G49", "T1", "M6", "T0 M6"]
        words += ["G43.1 Z5", "G43.2 H1", "M61 Q2", "G49 G0 Z7", "G43 H0"]
        self.lines.append(self.rng.choice(words))
        if "arc" in self.kinds:
            # The interpreter in Python does not know after a tool change where an arc has ended.
            self.lines.append("G90 G0 X250 Y200 Z-150 B10 C20")

    def machine(self) -> None:
        """Machine coordinates and reference positions."""
        words = [f"G53 G0 {self.words('XYZBC')}", f"G53 G1 {self.words('XYZBC')}", "G53 G0 X250 Y200 Z-150 B10 C20"]
        words += ["G28", "G30", f"G28 {self.words('XYZ')}", "G28.1", "G30.1", "G0 X250 Y200 Z-150 B10 C20"]
        words += [f"G53 {self.words('XYZBC')}", f"G30 {self.words('BC')}", "G91 G28 Z0\nG90"]
        self.lines += self.rng.choice(words).split("\n")

    def assign(self) -> None:
        """Assignments, alone, several, or in the block of a move."""
        rng = self.rng
        names = rng.sample(NAMED, rng.choice([1, 1, 2]))
        text = " ".join(f"{name}{rng.choice(['=', ' = '])}{self.value(-9, 90)}" for name in names)
        if rng.random() < 0.25 and self.known:
            move = f"G1 X{rng.choice(self.known)} Y{self.number(1, 99)}"
            text = rng.choice([f"{text} {move}", f"{move} {text}"])
        self.lines.append(text)
        self.known += [name for name in names if name not in self.known]

    def cycle(self) -> None:
        """A drilling cycle at some places, its words changed on the way.

        Left out, because twin reads it as on Fanuc, and says so: R that rises after G99, or lies above the tool there, G98 after G99
        (`test_linuxcnc`). G89 feeds up to the initial level, and the control itself taps threads and bores with a spindle that stops.
        """
        rng = self.rng
        placed = rng.random() < 0.9
        code = rng.choice(CYCLES) if placed else "81"
        plane = rng.choice([17, 17, 18, 19])
        places, depth = {17: ("XY", "Z"), 18: ("XZ", "Y"), 19: ("YZ", "X")}[plane]
        if placed:
            self.lines += ["G80", f"G{plane} G90", f"G0 {' '.join(f'{axis}100' for axis in places)} {depth}50"]
            self.plane = plane
        level = "G99" if code == "89" else rng.choice(["G98", "G99"]) if placed else "G98"
        top = rng.uniform(30.0, 60.0 if rng.random() < 0.1 and level == "G98" else 49.0)
        relative = rng.random() < 0.3
        heights = f"{depth}{self.number(-30, -9)} R{top - 50.0 if relative else top:.2f}"
        words = f"{'G91 ' if relative else ''}{level} G{code} {self.words(places)} {heights}"
        words += " P0.5" if code in ("82", "89") else f" Q{self.number(3, 9)}" if code in ("73", "83") else ""
        self.lines.append(words + rng.choice(["", "", "", "", f" L{rng.choice([1, 2, 3])}"]))
        for _ in range(rng.choice([0, 1, 3])):
            top = rng.uniform(2.0, top)
            lower = f" R{top - 50.0 if relative else top:.3f} {depth}{self.number(-40, -9)}"
            extra = rng.choice(["", "", "", lower, f" {depth}{self.number(-40, -9)}", " G91", " L2", " G90"])
            self.lines.append(rng.choice([self.words(places) + extra, self.words(places) + extra, "M8", "G20"]))
        self.lines += [rng.choice(["G80", "G80", f"G0 {depth}60", f"G80 G0 {depth}60"]), "G90 G21"]

    def call(self) -> None:
        """A subprogram with arguments and variables of its own."""
        rng = self.rng
        name = rng.choice([f"{100 + self.count}", f"<drill{self.count}>", f"<Drill Two {self.count}>"])
        self.count += 1
        outer, self.known = self.known, ["#1", "#2", *(name for name in self.known if name.startswith(("#<_", "#10")))]
        body = ControlProgram(rng, tuple(kind for kind in self.kinds if kind not in ("call", "loop", "cycle")))
        body.lines, body.known, body.plane = [], self.known, self.plane
        body.grow(rng.choice([1, 2, 4]))
        if rng.random() < 0.3:
            body.lines.append(rng.choice(["#<a>=3", "#1=5", "#<_glob>=#1", "G1 X#3"]))
            body.lines.append("G1 Y#1")
        end = rng.choice(
            [f"o{name} endsub", f"o{name} endsub", f"o{name} return\no{name} endsub", f"o{name} endsub [#1+1]"]
        )
        self.subs += [f"o{name} sub", *body.lines, end]
        self.known, self.plane = outer, body.plane
        for _ in range(rng.choice([1, 2])):
            self.lines.append(f"o{name} call [{self.value(1, 90)}] [{self.value(1, 90)}]")
            if rng.random() < 0.3:
                self.lines.append(f"G1 X{rng.choice(['#<_value>', '#1', *self.known])}")

    def loop(self) -> None:
        """A loop or a condition."""
        rng, number = self.rng, 500 + self.count
        self.count += 1
        body = f"G1 {self.words('XYZ')}"
        kind = rng.choice(["repeat", "while", "if", "do"])
        if kind == "repeat":
            self.lines += [f"o{number} repeat [{rng.randint(0, 3)}]", body, f"o{number} endrepeat"]
        elif kind == "if":
            test = self.expression(1)
            self.lines += [f"o{number} if [{test} GT 3]", body, f"o{number} else", "G0 X5", f"o{number} endif"]
        else:
            self.lines += ["#150 = 0", f"o{number} {kind}" if kind == "do" else f"o{number} while [#150 LT 3]"]
            self.lines += ["#150 = [#150+1]", body]
            self.lines.append(f"o{number} while [#150 LT 3]" if kind == "do" else f"o{number} endwhile")

    def other(self) -> None:
        """A block that moves nothing, or changes modes in a way of its own."""
        words = [
            "",
            "(G2 X5)",
            "M8",
            "S1000 M3",
            "G4 P0.1",
            "F250",
            "/G1 X5",
            "; G91",
            "N100 G1 X7",
            "M70",
            "M72",
            "M73",
        ]
        words += ["G8", "G7", "M48", "M64 P1", "M66 P0 L0", "(print,#1)", "%", "G1 (a) X5 (b) Y6", "X 1 0", "G 1 Z 5"]
        words += ["M98 P100", "G5.1 X1 I1 J1", "M19 R0", "M1", "M6 T1", "G96 D1000 S100", "G38.3 Z-5", "G33 Z5 K1"]
        words += ["M67 E0 Q5", "G1 X5 Y6 M68 E1 Q-2", "M66 E1 L0", "M61 Q1", "M65 P3 G0 Y4"]
        words += ["G81 X5 Y5 Z-5 R2\nM67 E1 Q3\nX9\nG80", "o900 call [3] [7]", "M68 E0 Q2 X9", "G2 X5 Y5 R40 M19"]
        word = self.rng.choice(words)
        self.subs += RECURSION if "o900" in word and RECURSION[0] not in self.subs else []
        self.lines += word.split("\n")
        if "arc" in self.kinds:
            self.lines.append("G90 G0 X250 Y200 Z-150 B10 C20")
