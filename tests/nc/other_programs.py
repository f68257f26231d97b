"""Random programs in Heidenhain plain language and APT, written from their paths; nothing here is shared with `twin.nc`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from random import Random

from tests.nc.modal_programs import AXES, HIGH, LOW, Event, centre_by_radius

TOOL_PLANES = {"Z": (0, 1), "Y": (2, 0), "X": (1, 2)}


@dataclass
class PlainProgram:
    """A plain-language program that grows by random statements; FMAX and I apply to their own block or word only."""

    rng: Random
    lines: list[str] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    at: list[float] = field(default_factory=lambda: [250.0, 200.0, -150.0, 10.0, 20.0])
    unit: float = 1.0
    plane: tuple[int, int] = (0, 1)
    pole: dict[int, float] = field(default_factory=dict)
    pole_plane: set[int] | None = None

    def __post_init__(self) -> None:
        self.unit = self.rng.choice([1.0, 25.4])
        self.lines.append(f"BEGIN PGM A {'MM' if self.unit == 1.0 else 'INCH'}")
        words = [self.word(axis, value, relative=False) for axis, value in enumerate(self.at)]
        self.lines.append(f"L {' '.join(words)} FMAX")
        self.events.append(Event(0, tuple(self.at)))

    @property
    def text(self) -> str:
        return "\n".join([*self.lines, "END PGM A MM", ""])

    def grow(self, statements: int) -> PlainProgram:
        """Add statements and return the program."""
        for _ in range(statements):
            self.rng.choice([self.line, self.line, self.circle, self.by_radius, self.tool, self.pole_block, self.run])()
        return self

    def number(self, value: float, unit: float) -> tuple[str, float]:
        text = f"{value / unit:+.{3 if unit == 1.0 else 5}f}"
        exact = float(text) * unit
        if self.rng.random() < 0.1:
            name = f"Q{len(self.lines)}"
            self.lines.append(f"{self.rng.choice(['', 'FN 0: '])}{name} = {text}")
            return name, exact
        return (text.replace(".", ",") if self.rng.random() < 0.3 else text), exact

    def word(self, axis: int, target: float, *, relative: bool | None = None) -> str:
        relative = self.rng.random() < 0.25 if relative is None else relative
        text, value = self.number(target - self.at[axis] if relative else target, self.unit if axis < 3 else 1.0)
        self.at[axis] = self.at[axis] + value if relative else value
        return f"{'I' if relative else ''}{AXES[axis]}{text}"

    def place(self, axis: int) -> float:
        return self.rng.uniform(LOW[axis], HIGH[axis])

    def line(self) -> None:
        axes = sorted(self.rng.sample(range(5), self.rng.choice([1, 2, 3, 5])))
        words = [self.word(axis, self.place(axis)) for axis in axes]
        rapid = self.rng.random() < 0.4
        tail = self.rng.choice(["FMAX", "R0 FMAX", "F MAX M8"] if rapid else ["", "F500", "R0 F500", "F AUTO"])
        self.lines.append(f"L {' '.join(words)} {tail}")
        self.events.append(Event(0 if rapid else 1, tuple(self.at)))

    def run(self) -> None:
        for _ in range(18):
            axis = self.rng.randrange(5)
            self.lines.append(f"L {self.word(axis, self.place(axis), relative=False)} F500")
            self.events.append(Event(1, tuple(self.at)))

    def tool(self) -> None:
        axis = self.rng.choice("XYZ")
        if self.plane != TOOL_PLANES[axis]:
            self.pole, self.pole_plane = {}, None
        self.plane = TOOL_PLANES[axis]
        number = self.rng.choice(["3 ", "", '"MILL X" '])
        self.lines.append(f"TOOL CALL {number}{axis} S4000")
        if number:  # the position along another tool is given anew
            words = [self.word(axis, self.place(axis), relative=False) for axis in range(3)]
            self.lines.append(f"L {' '.join(words)} FMAX")
            self.events.append(Event(0, tuple(self.at)))

    def pole_block(self) -> None:
        """A pole somewhere, given in part or relative to the position; it holds until the next."""
        if self.rng.random() < 0.3:
            self.pole, self.pole_plane = dict(enumerate(self.at[:3])), None
            self.lines.append("CC")
            return
        words, axes = [], self.rng.sample(range(3), self.rng.choice([1, 2]))
        if len(axes) == 2:  # they name the plane of the arc
            self.pole, self.pole_plane = {}, {*axes}
        for axis in axes:
            relative = self.rng.random() < 0.3
            text, value = self.number(self.place(axis) - (self.at[axis] if relative else 0.0), self.unit)
            self.pole[axis] = value + (self.at[axis] if relative else 0.0)
            words.append(f"{'I' if relative else ''}{AXES[axis]}{text}")
        self.lines.append(f"CC {' '.join(words)}")

    def circle(self) -> None:
        """An arc about a pole: in its plane, to a point at the same distance."""
        a, b = self.plane
        elsewhere = self.pole_plane not in (None, {a, b})
        if a not in self.pole or b not in self.pole or elsewhere or self.rng.random() < 0.3:
            self.pole_of_plane()
        centre = [self.pole[a], self.pole[b]]
        start = (self.at[a], self.at[b])
        radius = math.hypot(start[0] - centre[0], start[1] - centre[1])
        if radius < 1.0:
            return
        share, clockwise = self.rng.uniform(0.2, 6.0), self.rng.random() < 0.5
        angle = math.atan2(start[1] - centre[1], start[0] - centre[0]) + (-share if clockwise else share)
        words = [
            self.word(a, centre[0] + radius * math.cos(angle)),
            self.word(b, centre[1] + radius * math.sin(angle)),
        ]
        self.add_arc(f"C {' '.join(words)}", share, centre, clockwise=clockwise)

    def pole_of_plane(self) -> None:
        """A pole near the position, in the plane of the tool."""
        words, self.pole_plane = [], {*self.plane}
        for axis in self.plane:
            text, value = self.number(self.at[axis] + self.rng.choice([-1, 1]) * self.rng.uniform(5, 30), self.unit)
            self.pole[axis] = value
            words.append(f"{AXES[axis]}{text}")
        self.lines.append(f"CC {' '.join(words)}")

    def by_radius(self) -> None:
        a, b = self.plane
        start, share, clockwise = (self.at[a], self.at[b]), self.rng.uniform(0.3, 5.9), self.rng.random() < 0.5
        if abs(share - math.pi) < 0.4:
            share = 2.0
        radius, first = self.rng.uniform(5.0, 30.0), self.rng.uniform(0.0, 6.3)
        centre = [start[0] - radius * math.cos(first), start[1] - radius * math.sin(first)]
        angle = first + (-share if clockwise else share)
        words = [
            self.word(a, centre[0] + radius * math.cos(angle)),
            self.word(b, centre[1] + radius * math.sin(angle)),
        ]
        text, value = self.number(radius if share < math.pi else -radius, self.unit)
        centre = centre_by_radius(start, (self.at[a], self.at[b]), abs(value), centre)
        self.add_arc(f"CR {' '.join(words)} R{text}", share, centre, clockwise=clockwise)

    def add_arc(self, head: str, share: float, centre: list[float], *, clockwise: bool) -> None:
        self.lines.append(f"{head} DR{'-' if clockwise else '+'}")
        sweep = -share if clockwise else share
        self.events.append(Event(2 if clockwise else 3, tuple(self.at), self.plane, (centre[0], centre[1]), sweep))


@dataclass
class CutterLocations:
    """Cutter locations that grow by random statements: RAPID applies to the next location only, a tool vector until the next one."""

    rng: Random
    lines: list[str] = field(default_factory=list)
    rapid: list[bool] = field(default_factory=list)
    points: list[tuple[float, ...]] = field(default_factory=list)
    vectors: list[tuple[float, ...]] = field(default_factory=list)
    unit: float = 1.0
    vector: tuple[float, ...] = (0.0, 0.0, 1.0)
    pending: bool = False

    @property
    def text(self) -> str:
        return "\n".join([*self.lines, "END-OF-PATH", ""])

    def grow(self, statements: int) -> CutterLocations:
        """Add statements and return the program."""
        for _ in range(statements):
            self.rng.choice([self.goto, self.goto, self.goto, self.rapid_word, self.feed, self.units, self.run])()
        return self

    def goto(self) -> None:
        point = [round(self.rng.uniform(-100.0, 100.0), 4) for _ in range(3)]
        words = [f"{value:.4f}" for value in point]
        if self.rng.random() < 0.4:
            raw = [round(self.rng.uniform(-1.0, 1.0), 6) for _ in range(3)]
            length = math.sqrt(sum(value * value for value in raw))
            self.vector = tuple(value / length for value in raw)
            words += [f"{value:.9f}" for value in self.vector]
        word = "FROM" if self.rng.random() < 0.05 else "GOTO"
        split = self.rng.random() < 0.15
        self.lines.append(f"{word}/{words[0]}," + ("$\n  " if split else "") + ",".join(words[1:]))
        self.points.append(tuple(value * self.unit for value in point))
        self.vectors.append(self.vector)
        self.rapid.append(word == "FROM" or self.pending)
        self.pending &= word == "FROM"

    def run(self) -> None:
        for _ in range(20):
            self.goto()

    def rapid_word(self) -> None:
        self.lines.append("RAPID")
        self.pending = True

    def feed(self) -> None:
        self.lines.append("FEDRAT/MMPM,500.0")
        self.pending = False

    def units(self) -> None:
        inch = self.rng.random() < 0.5
        self.unit = 25.4 if inch else 1.0
        self.lines.append(f"UNITS/{'INCHES' if inch else 'MM'}")
