"""Random ISO programs whose modal state changes at any place, and their tool path on a control.

A program is written from its path, by modal rules of its own: nothing here is shared with `twin.nc`. Rules: LinuxCNC's G-code reference
and Fanuc's operator's manual (30i), which agree but for what `ModalProgram.judge` says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from random import Random
from typing import NamedTuple

AXES = "XYZBC"
PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}
CENTRES = "IJK"
LOW, HIGH = (150.0, 120.0, -300.0, 5.0, -170.0), (350.0, 320.0, -100.0, 80.0, 170.0)
STEPPED = {73: False, 83: True}
"""Drilling cycles in steps, and whether the drill leaves the hole after each."""
DWELLS, FED_UP = (82, 89), (85, 89)


class Event(NamedTuple):
    """One motion.

    Attributes:
        code: 0, 1, 2 or 3.
        end: position at the end point, mm and degrees.
        plane, centre, sweep: of an arc: indices of the two axes, mm, signed radians.
    """

    code: int
    end: tuple[float, ...]
    plane: tuple[int, int] = (0, 1)
    centre: tuple[float, float] = (0.0, 0.0)
    sweep: float = 0.0


@dataclass
class ModalProgram:
    """A program that grows by random statements.

    Attributes:
        rng: source of every choice.
        judge: ``"fanuc"``, or ``"linuxcnc"``: what both understand alike. There no motion code applies after G80, a cycle code needs
            all its words, and a hole has no rotary axis. R must not rise, and G98 not follow G99: the tool goes to that height before
            it goes to the next hole. G89 feeds up to the initial level.
        peck_mm: height above the bottom at which feeding begins again after a retract for chips.
        lines, events: the program and its path so far.
    """

    rng: Random
    judge: str = "fanuc"
    peck_mm: float = 0.5
    lines: list[str] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    at: list[float] = field(default_factory=lambda: [250.0, 200.0, -150.0, 10.0, 20.0])
    unit: float = 1.0
    plane: int = 17
    relative: bool = False
    absolute_centre: bool = False
    code: int | None = 0
    to_initial: bool = True

    def __post_init__(self) -> None:
        self.lines += ["G90 G21 G17 G94 G98 G40 G49 G91.1 F500", "G0 X250 Y200 Z-150 B10 C20"]
        self.events.append(Event(0, tuple(self.at)))

    @property
    def text(self) -> str:
        return "\n".join([*self.lines, "G80 M2", ""])

    def grow(self, statements: int) -> ModalProgram:
        """Add statements and return the program."""
        for _ in range(statements):
            self.rng.choice([self.line, self.line, self.arc, self.arc, self.mode, self.series, self.run, self.other])()
        return self

    # ------------------------------------------------------------------ text

    def write(self, words: list[str]) -> None:
        """Add a block, in one of the forms that programs have."""
        rng = self.rng
        if rng.random() < 0.3:
            rng.shuffle(words)
        text = rng.choice([" ", " ", ""]).join(words)
        if rng.random() < 0.2:
            text = f"N{10 * len(self.lines)} {text}"
        if rng.random() < 0.2:
            text = f"{text} {rng.choice(['(X1 G0)', '; G2 X1'])}"
        self.lines.append(text.lower() if rng.random() < 0.15 else text)

    def number(self, value: float, unit: float) -> tuple[str, float]:
        """Return a value as text in program units, and the value that this text has."""
        text = f"{value / unit:.{3 if unit == 1.0 else 5}f}"
        exact = float(text) * unit
        form = self.rng.random()
        if form < 0.3 and "." in text:
            text = text.rstrip("0")
        elif form < 0.35:
            text = f"[{text}*2/2]"
        elif form < 0.4 and value >= 0.0:
            text = f"+{text}"
        return text, exact

    def axis_word(self, axis: int, target: float) -> str:
        """Return the word that moves an axis near a target, and move it."""
        unit = self.unit if axis < 3 else 1.0
        text, value = self.number(target - self.at[axis] if self.relative else target, unit)
        self.at[axis] = self.at[axis] + value if self.relative else value
        return f"{AXES[axis]}{text}"

    def place(self, axis: int) -> float:
        return self.rng.uniform(LOW[axis], HIGH[axis])

    def modes(self) -> list[str]:
        """Return words that change modes in the block of a motion; they take effect before it."""
        words = []
        if self.rng.random() < 0.12:
            self.unit = self.rng.choice([1.0, 25.4])
            names = (["G21"], ["G20"]) if self.judge == "linuxcnc" else (["G21", "G71", "G710"], ["G20", "G70", "G700"])
            words.append(self.rng.choice(names[self.unit != 1.0]))
        if self.rng.random() < 0.12:
            self.relative = self.rng.random() < 0.5
            words.append("G91" if self.relative else "G90")
        return words

    def motion_word(self, code: int) -> list[str]:
        """Return the motion word, which may be left out where it is in force."""
        needed = self.code != code
        self.code = code
        return [self.rng.choice([f"G{code}", f"G0{code}"])] if needed or self.rng.random() < 0.4 else []

    def move(self, code: int) -> None:
        self.events.append(Event(code, tuple(self.at)))

    # ------------------------------------------------------------------ statements

    def mode(self) -> None:
        """A block that only changes modes."""
        rng, words = self.rng, self.modes()
        if rng.random() < 0.7:
            self.plane = rng.choice([17, 18, 19])
            words.append(f"G{self.plane}")
        if rng.random() < 0.4:
            self.absolute_centre = rng.random() < 0.5
            words.append("G90.1" if self.absolute_centre else "G91.1")
        if rng.random() < 0.3:
            self.to_initial = rng.random() < 0.5
            words.append("G98" if self.to_initial else "G99")
        self.write([*words, "M8"])

    def line(self) -> None:
        """A straight move of some axes."""
        words, code = self.modes(), self.rng.choice([0, 1])
        words += self.motion_word(code)
        axes = self.rng.sample(range(5), self.rng.choice([1, 1, 2, 3, 5]))
        words += [self.axis_word(axis, self.place(axis)) for axis in sorted(axes)]
        self.write(words + (["F600"] if self.rng.random() < 0.2 else []))
        self.move(code)

    def run(self) -> None:
        """Many simple blocks, which are read together."""
        code = self.rng.choice([0, 1])
        head = self.motion_word(code)
        for _ in range(self.rng.choice([3, 18])):
            axes = sorted(self.rng.sample(range(5), self.rng.choice([1, 2, 3])))
            words = head + [self.axis_word(axis, self.place(axis)) for axis in axes]
            self.lines.append(" ".join(words) if "[" not in "".join(words) else "".join(words))
            self.move(code)
            head = []

    def arc(self) -> None:
        """An arc or helix, by its centre or its radius, with full turns."""
        rng, words = self.rng, self.modes()
        a, b, c = PLANES[self.plane]
        quarter = rng.random() < 0.3
        radius, first = (
            rng.uniform(5.0, 40.0),
            rng.choice([0.0, 0.5, 1.0, 1.5]) * math.pi if quarter else rng.uniform(0, 7),
        )
        centre = [round((self.at[a] - radius * math.cos(first)) / self.unit, 4) * self.unit]
        centre.append(round((self.at[b] - radius * math.sin(first)) / self.unit, 4) * self.unit)
        start, full = (self.at[a], self.at[b]), rng.random() < 0.2
        share = rng.choice([rng.uniform(0.3, 2.6), rng.uniform(3.6, 5.9)])
        clockwise = rng.random() < 0.5
        words += self.motion_word(2 if clockwise else 3)
        by_radius = not full and rng.random() < 0.3
        if not full:
            angle = math.atan2(start[1] - centre[1], start[0] - centre[0]) + (-share if clockwise else share)
            size = math.hypot(start[0] - centre[0], start[1] - centre[1])
            words.append(self.axis_word(a, centre[0] + size * math.cos(angle)))
            words.append(self.axis_word(b, centre[1] + size * math.sin(angle)))
        if rng.random() < 0.4:
            words.append(self.axis_word(c, self.place(c)))
        if rng.random() < 0.2:
            words.append(self.axis_word(4, self.place(4)))
        if by_radius:
            size = math.hypot(start[0] - centre[0], start[1] - centre[1])
            text, value = self.number(size if share < math.pi else -size, self.unit)
            words.append(f"R{text}")
            centre = centre_by_radius(start, (self.at[a], self.at[b]), abs(value), centre)
        else:
            for i, axis in enumerate((a, b)):
                text, value = self.number(centre[i] if self.absolute_centre else centre[i] - start[i], self.unit)
                centre[i] = value if self.absolute_centre else start[i] + value
                if value or self.absolute_centre or rng.random() < 0.5:
                    words.append(f"{CENTRES[axis]}{text}")
        turns = rng.choice([0, 0, 1, 2, 3])
        if turns:
            words.append(f"P{turns}")
        self.write(words)
        sweep = 2.0 * math.pi if full else share
        sweep += 2.0 * math.pi * max(0, turns - 1)
        self.events.append(
            Event(2 if clockwise else 3, tuple(self.at), (a, b), (centre[0], centre[1]), -sweep if clockwise else sweep)
        )

    def other(self) -> None:
        """A block that moves nothing."""
        self.lines.append(
            self.rng.choice(["", "(G2 X5)", "M8", "S1000 M3", "G4 P1", "G64 P0.01", "F250", "; G91", "G61"])
        )

    # ------------------------------------------------------------------ drilling

    def series(self) -> None:
        """A drilling cycle at several positions, its words changed on the way."""
        rng = self.rng
        if self.plane != 17 or self.relative:
            self.plane, self.relative = 17, False
            self.write(["G17", "G90"])
        before, initial = self.code, self.at[2]
        sticky: dict[str, float] = {}
        code = 0
        for hole in range(rng.choice([1, 2, 4, 6])):
            words = []
            if not hole or rng.random() < 0.3:
                code = rng.choice([81, 82, 83, 73, 85, *([89] if self.judge == "fanuc" else [])])
                words.append(f"G{code}")
            if rng.random() < 0.3 and (self.judge == "fanuc" or not hole):
                self.to_initial = rng.random() < 0.5
                words.append("G98" if self.to_initial else "G99")
            axes = sorted(rng.sample([0, 1], rng.choice([1, 1, 2])))
            axes += [4] if rng.random() < 0.1 and self.judge == "fanuc" else []
            words += [self.axis_word(axis, self.place(axis)) for axis in axes]
            if words[:1] == [f"G{code}"] and self.judge == "linuxcnc":
                sticky.clear()
            words += self.heights(sticky, initial)
            if code in STEPPED and ("Q" not in sticky or rng.random() < 0.3):
                words.append(self.sticky(sticky, "Q", rng.uniform(3.0, 12.0) if rng.random() < 0.9 else 0.4))
            if code in DWELLS and ("P" not in sticky or rng.random() < 0.2):
                sticky["P"] = 0.5
                words.append("P0.5")
            self.write(words)
            self.drill(code, sticky, sticky["R"] if not self.to_initial else initial)
            if rng.random() < 0.3:
                self.other()
        self.code = before if self.judge == "fanuc" else None
        cancelled = rng.random() < 0.6
        if cancelled:
            self.write(["G80"])
        elif self.judge == "fanuc":
            self.code = None  # a motion code ends the cycle, too
        if not cancelled or rng.random() < 0.5:
            code = rng.choice([0, 1])
            self.write([*self.motion_word(code), self.axis_word(2, initial)])
            self.move(code)

    def heights(self, sticky: dict[str, float], initial: float) -> list[str]:
        """Return the words R and Z of a hole, where they are new or change."""
        rng, words, first = self.rng, [], "R" not in sticky
        if first or rng.random() < 0.25:
            highest = initial if self.judge == "fanuc" else self.at[2]
            words.append(self.sticky(sticky, "R", highest - rng.choice([0.5, 5.0, 9.0])))
        if first or rng.random() < 0.25 or sticky["Z"] > sticky["R"] - 2.0:
            words.append(self.sticky(sticky, "Z", sticky["R"] - rng.uniform(15.0, 31.0)))
        return words

    def sticky(self, sticky: dict[str, float], letter: str, value: float) -> str:
        text, sticky[letter] = self.number(value, self.unit)
        return f"{letter}{text}"

    def drill(self, code: int, sticky: dict[str, float], retract: float) -> None:
        """Add the motions of one hole."""
        self.move(0)
        top, depth = sticky["R"], sticky["Z"]
        self.to(0, top)
        if code in STEPPED:
            reached = top - sticky["Q"]
            while reached > depth + 1e-9:
                self.to(1, reached)
                if STEPPED[code]:
                    self.to(0, top)
                self.to(0, min(reached + self.peck_mm, top))
                reached -= sticky["Q"]
        self.to(1, depth)
        if code in FED_UP:
            self.to(1, top)
        self.to(0, retract)

    def to(self, code: int, height: float) -> None:
        self.at[2] = height
        self.move(code)


def centre_by_radius(
    start: tuple[float, float], end: tuple[float, float], radius: float, near: list[float]
) -> list[float]:
    """Return which of the two centres of circles through two points is nearer to a place."""
    middle = complex(*start) + complex(*end)
    chord = complex(*end) - complex(*start)
    height = math.sqrt(max(0.0, radius**2 - abs(chord) ** 2 / 4.0)) * 1j * chord / abs(chord)
    found = min((middle / 2.0 + sign * height for sign in (1.0, -1.0)), key=lambda at: abs(at - complex(*near)))
    return [found.real, found.imag]


def moved(events: list[Event]) -> list[Event]:
    """Return events without those that stay where they are; a full circle does not."""
    kept: list[Event] = []
    for event in events:
        still = kept and all(abs(a - b) < 2e-3 for a, b in zip(event.end, kept[-1].end, strict=True))
        if not still or event.sweep:
            kept.append(event)
    return kept


def difference(one: list[Event], other: list[Event], tolerance: float) -> str:
    """Return the first difference of two paths in words, empty if there is none."""
    one, other = moved(one), moved(other)
    for i, (a, b) in enumerate(zip(one, other, strict=False)):
        ends = max(abs(x - y) for x, y in zip(a.end, b.end, strict=True))
        arcs = max(abs(a.centre[0] - b.centre[0]), abs(a.centre[1] - b.centre[1]))
        if (
            a.code != b.code
            or a.plane != b.plane
            or ends > tolerance
            or arcs > 100.0 * tolerance
            or abs(a.sweep - b.sweep) > 0.02
        ):
            return f"motion {i}: {a} and {b}"
    return "" if len(one) == len(other) else f"{len(one)} and {len(other)} motions"
