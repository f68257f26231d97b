"""Patterns outside the catalogue: shifts of the targets of one side in one direction, as functions of columns of the table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.scored_cases.plan import Plan, TruthAxis
from tests.truth.any_machine import TruthMachine

Numbers = dict[str, float]
HALF_WAVES = (3.0, 8.0)
"""Range of the number of half waves of a short wave over its column."""
TEETH = (3, 7)
BINS = 60
AS_MUCH = 0.9
"""Share of a pattern's variance explained by another column from which that column also counts as right."""
MIDDLE = (0.25, 0.75)
"""Part of a column's range for the position of a jump or the centre of a bump."""


@dataclass(frozen=True)
class Outside:
    """One pattern with its parameters.

    Attributes:
        pattern: a name of `PATTERNS`.
        columns: columns that the pattern depends on, in the order of its formula.
        side: side whose targets it moves, ``tool`` or ``work``.
        frame: frame in which its direction is fixed: ``base`` or ``table``.
        direction: unit vector.
        numbers: parameters of the formula.
        size_um: factor of the formula, µm.
    """

    pattern: str
    columns: tuple[str, ...]
    side: str
    frame: str
    direction: tuple[float, float, float]
    numbers: Numbers
    size_um: float = 1.0

    def moved(self, machine: TruthMachine, plan: Plan) -> np.ndarray:
        """Return (n, 3) the shift of each row's target in the base, mm."""
        size = 1e-3 * self.size_um * PATTERNS[self.pattern].shape(plan, self.columns, self.numbers)
        vector = np.array(self.direction)
        along = machine.carried(plan, vector) if self.frame == "table" else np.broadcast_to(vector, (len(plan), 3))
        return (size * (plan.carrier == self.side))[:, None] * along

    def depends_on(self, machine: TruthMachine, plan: Plan) -> tuple[str, ...]:
        """Return the columns that count as right: those of the formula, and others that explain the pattern as well.

        For a direction of approach this is its axis; for a function of time or of a temperature, any of these that explains `AS_MUCH`
        of it on this plan.
        """
        found = [*self.columns, *(axis.column for axis in machine.axes if f"approach_{axis.name}" in self.columns)]
        columns = plan.columns()
        slow = [name for name in columns if name == "time_s" or name.startswith("T_")]
        if len(self.columns) == 1 and self.columns[0] in slow:
            shape = PATTERNS[self.pattern].shape(plan, self.columns, self.numbers)
            found += [name for name in slow if _explained(shape, columns[name]) >= AS_MUCH]
        return tuple(dict.fromkeys(found))

    def to_dict(self) -> dict[str, Any]:
        return {
            "pattern": self.pattern,
            "columns": list(self.columns),
            "side": self.side,
            "frame": self.frame,
            "direction": list(self.direction),
            "numbers": self.numbers,
            "size_um": self.size_um,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Outside:
        x, y, z = data["direction"]
        own = {key: data[key] for key in ("pattern", "side", "frame", "numbers", "size_um")}
        return cls(columns=tuple(data["columns"]), direction=(x, y, z), **own)


@dataclass(frozen=True)
class Pattern:
    """A kind of pattern: a function that draws its location and parameters, and its formula."""

    draw: Callable[[np.random.Generator, TruthMachine, Plan], Outside]
    shape: Callable[[Plan, tuple[str, ...], Numbers], np.ndarray]


def _explained(shape: np.ndarray, column: np.ndarray) -> float:
    """Return the share of a function's variance explained by its means over `BINS` equally filled bins of a column."""
    part = np.argsort(np.argsort(column, kind="stable")) * BINS // len(column)
    means = np.bincount(part, shape) / np.bincount(part)
    return 1.0 - float(np.var(shape - means[part]) / np.var(shape))


def _unit(plan: Plan, column: str) -> np.ndarray:
    """Return (n,) a column scaled from 0 to 1 over its range, or over one turn for an endless axis."""
    values = plan.columns()[column]
    if _endless(plan, column):
        return np.mod(values / 360.0, 1.0)
    return np.asarray((values - values.min()) / np.ptp(values))


def _endless(plan: Plan, column: str) -> bool:
    return any(axis.endless and axis.column == column for axis in plan.axes)


def _wave(plan: Plan, column: str, halves: float, phase: float) -> np.ndarray:
    whole = 2.0 * np.round(halves / 2.0) if _endless(plan, column) else halves
    return np.cos(np.pi * whole * _unit(plan, column) + phase)


def _step(plan: Plan, column: str, place: float) -> np.ndarray:
    """Return a step of ±0.5; for an endless axis it returns after half a turn."""
    u = _unit(plan, column)
    return np.where(np.mod(u - place, 1.0) < 0.5 if _endless(plan, column) else u > place, 0.5, -0.5)


def _hill(plan: Plan, column: str, place: float, width: float) -> np.ndarray:
    off = _unit(plan, column) - place
    if _endless(plan, column):
        off = np.mod(off + 0.5, 1.0) - 0.5
    return np.exp(-0.5 * (off / width) ** 2)


def _short_waves(plan: Plan, columns: tuple[str, ...], v: Numbers) -> np.ndarray:
    return _wave(plan, columns[0], v["halves_1"], v["phase_1"]) * _wave(plan, columns[1], v["halves_2"], v["phase_2"])


def _smooth(plan: Plan, columns: tuple[str, ...], v: Numbers) -> np.ndarray:
    first, second = (2.0 * _unit(plan, column) - 1.0 for column in columns)
    total = np.zeros(len(plan))
    for k in range(3):
        wave = np.sin(v[f"a_{k}"] * first + v[f"phase_{k}"]) * np.cos(v[f"b_{k}"] * second + v[f"turn_{k}"])
        total += v[f"size_{k}"] * wave
    return total


def _lost_motion(plan: Plan, columns: tuple[str, ...], v: Numbers) -> np.ndarray:
    along = np.sin(2.0 * np.pi * v["waves"] * _unit(plan, columns[1]) + v["phase"])
    return plan.approach_of(columns[0].removeprefix("approach_")) * (along - along.mean())


def _jump(plan: Plan, columns: tuple[str, ...], v: Numbers) -> np.ndarray:
    return _step(plan, columns[0], v["place"])


def _jump_product(plan: Plan, columns: tuple[str, ...], v: Numbers) -> np.ndarray:
    return _step(plan, columns[0], v["place"]) * (2.0 * _unit(plan, columns[1]) - 1.0)


def _bump(plan: Plan, columns: tuple[str, ...], v: Numbers) -> np.ndarray:
    return _hill(plan, columns[0], v["place_1"], v["width_1"]) * _hill(plan, columns[1], v["place_2"], v["width_2"])


def _sawtooth(plan: Plan, columns: tuple[str, ...], v: Numbers) -> np.ndarray:
    return np.mod(v["teeth"] * _unit(plan, columns[0]) + v["phase"], 1.0) - 0.5


def _drift(plan: Plan, columns: tuple[str, ...], v: Numbers) -> np.ndarray:
    """Return two raised cosines in time."""
    total = np.zeros(len(plan))
    for k in (1, 2):
        off = (_unit(plan, columns[0]) - v[f"place_{k}"]) / v[f"width_{k}"]
        total += v[f"size_{k}"] * np.where(np.abs(off) < 1.0, 0.5 + 0.5 * np.cos(np.pi * off), 0.0)
    return total


def _placed(
    rng: np.random.Generator,
    plan: Plan,
    pattern: str,
    columns: tuple[str, ...],
    numbers: Numbers,
    sides: tuple[str, ...] | None = None,
) -> Outside:
    """Return a pattern on a random side in a random direction."""
    found = sides or tuple(sorted({*plan.carrier.tolist()}))
    side = found[rng.integers(len(found))]
    frame = "table" if side == "work" and rng.random() < 0.5 else "base"
    return Outside(pattern, columns, side, frame, _unit_vector(rng.standard_normal(3)), numbers)


def _unit_vector(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(part) for part in vector / np.linalg.norm(vector))
    return x, y, z


def _names(plan: Plan, *, warm: bool) -> list[str]:
    return [name for name in plan.columns() if warm or not name.startswith("T_")]


def _two(rng: np.random.Generator, plan: Plan, *, warm: bool = False) -> tuple[str, ...]:
    return tuple(str(name) for name in rng.choice(_names(plan, warm=warm), 2, replace=False))


def _draw_short_waves(rng: np.random.Generator, machine: TruthMachine, plan: Plan) -> Outside:
    numbers = {f"halves_{k}": float(rng.uniform(*HALF_WAVES)) for k in (1, 2)}
    numbers |= {f"phase_{k}": float(rng.uniform(0.0, 2.0 * np.pi)) for k in (1, 2)}
    return _placed(rng, plan, "short_waves", _two(rng, plan), numbers)


def _draw_smooth(rng: np.random.Generator, machine: TruthMachine, plan: Plan) -> Outside:
    numbers: Numbers = {}
    for k in range(3):
        numbers |= {f"{name}_{k}": float(rng.uniform(1.0, 3.0)) for name in ("a", "b")}
        numbers |= {f"{name}_{k}": float(rng.uniform(0.0, 6.3)) for name in ("phase", "turn")}
        numbers[f"size_{k}"] = float(rng.standard_normal())
    return _placed(rng, plan, "smooth_product", _two(rng, plan, warm=True), numbers)


def _draw_lost_motion(rng: np.random.Generator, machine: TruthMachine, plan: Plan) -> Outside:
    axis, by = (machine.axes[i] for i in rng.integers(len(machine.axes), size=2))
    numbers = {"waves": float(rng.uniform(0.5, 1.0)), "phase": float(rng.uniform(0.0, 2.0 * np.pi))}
    found = _placed(rng, plan, "lost_motion", (f"approach_{axis.name}", by.column), numbers, (axis.side,))
    if axis is by and axis.linear:
        # Along the command it would be a reversal curve, which is in the catalogue.
        own, vector = machine.direction(axis.name), np.array(found.direction)
        direction = _unit_vector(vector - own * (own @ vector))
        return Outside(found.pattern, found.columns, found.side, "base", direction, numbers)
    return found


def _place_of_jump(rng: np.random.Generator, plan: Plan, column: str) -> float:
    """Return a position in the middle of the range; for time, within a round, as stations and targets may shift between rounds."""
    if column != "time_s":
        return float(rng.uniform(*MIDDLE))
    of_round = plan.time_s[plan.round == rng.choice(np.unique(plan.round))]
    moment = of_round.min() + np.ptp(of_round) * rng.uniform(*MIDDLE)
    return float((moment - plan.time_s.min()) / np.ptp(plan.time_s))


def _draw_jump(rng: np.random.Generator, machine: TruthMachine, plan: Plan) -> Outside:
    kinds = [
        [axis.column for axis in machine.axes if axis.linear],
        [axis.column for axis in machine.axes if not axis.linear],
        ["time_s"],
        [f"T_{name}_degC" for name in plan.warm],
    ]
    kinds = [kind for kind in kinds if kind]
    kind = kinds[rng.integers(len(kinds))]
    column = kind[rng.integers(len(kind))]
    return _placed(rng, plan, "jump", (column,), {"place": _place_of_jump(rng, plan, column)})


def _draw_jump_product(rng: np.random.Generator, machine: TruthMachine, plan: Plan) -> Outside:
    first, second = _two(rng, plan)
    if _endless(plan, second):
        # A slope needs a limited range.
        first, second = second, first
    return _placed(rng, plan, "jump_product", (first, second), {"place": _place_of_jump(rng, plan, first)})


def _draw_bump(rng: np.random.Generator, machine: TruthMachine, plan: Plan) -> Outside:
    numbers = {f"place_{k}": float(rng.uniform(*MIDDLE)) for k in (1, 2)}
    numbers |= {f"width_{k}": float(rng.uniform(0.1, 0.2)) for k in (1, 2)}
    return _placed(rng, plan, "bump", _two(rng, plan), numbers)


def _draw_sawtooth(rng: np.random.Generator, machine: TruthMachine, plan: Plan) -> Outside:
    choice = [(axis, side) for axis in machine.axes for side in np.unique(plan.carrier) if _free(machine, axis, side)]
    axis, side = choice[rng.integers(len(choice))]
    numbers = {"teeth": float(rng.integers(TEETH[0], TEETH[1] + 1)), "phase": float(rng.random())}
    found = _placed(rng, plan, "sawtooth", (axis.column,), numbers, (str(side),))
    if axis.side != side:
        return found
    return Outside(found.pattern, found.columns, found.side, "base", found.direction, numbers)


def _free(machine: TruthMachine, axis: TruthAxis, side: str) -> bool:
    """Return whether the axis's own error motions cannot explain a shift of a side: it is on the other side, or its frame turns."""
    own = [one for one in machine.axes if one.side == side]
    before = own[: own.index(axis)] if axis in own else []
    return axis.side != side or any(not one.linear for one in before)


def _draw_drift(rng: np.random.Generator, machine: TruthMachine, plan: Plan) -> Outside:
    numbers = {f"place_{k}": float(rng.uniform(0.1, 0.9)) for k in (1, 2)}
    numbers |= {f"width_{k}": float(rng.uniform(0.05, 0.15)) for k in (1, 2)}
    numbers |= {f"size_{k}": float(rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.0)) for k in (1, 2)}
    return _placed(rng, plan, "drift", ("time_s",), numbers)


PATTERNS = {
    "short_waves": Pattern(_draw_short_waves, _short_waves),
    "smooth_product": Pattern(_draw_smooth, _smooth),
    "lost_motion": Pattern(_draw_lost_motion, _lost_motion),
    "jump": Pattern(_draw_jump, _jump),
    "jump_product": Pattern(_draw_jump_product, _jump_product),
    "bump": Pattern(_draw_bump, _bump),
    "sawtooth": Pattern(_draw_sawtooth, _sawtooth),
    "drift": Pattern(_draw_drift, _drift),
}
