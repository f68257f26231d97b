"""Known effects: every family of the catalogue that a machine can have, with random locations and parameters."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial import legendre

from tests.scored_cases.carried import shares
from tests.scored_cases.plan import Plan
from tests.truth.any_machine import TruthMachine
from tests.truth.hidden import Hidden

SHAPE = ("order", "period", "phase", "time_constant", "exponent")
"""Parameters of an effect's shape, not of its size."""
INSTRUMENT = ("affine_scale", "frame_shift", "refraction_scale", "station_drift", "target_shift")
LEAST_LEFT = 1e-4
"""Smallest share of an effect's sum of squares that the set-up may leave; an absorbed effect cannot be found."""
LARGEST_MM = 1.0
"""Largest displacement of a point by a hidden effect, mm."""
LONGEST_CURVE = 6
HIGHEST_ORDER = 12
SHORTEST_PERIOD = 6.0
ITERATIONS = 3
"""Iterations of the size for the required λ: effects are nonlinear in size by about 1e-4."""
ALONE = 0.5
"""Smallest share of its λ that each of two effects keeps when the other is fitted in any form."""
FURTHER = ("reversal_curve", "thermal_lag", "spindle_growth", "affine_scale")
"""Families added to the catalogue later, with their own kind of case."""
PLACED = 500
"""Number of draws after which no effect, pair or pattern is assumed to be possible in these data."""
Rng = np.random.Generator
Where = Callable[[TruthMachine, Plan], list[str]]
Draw = Callable[[Rng, TruthMachine, Plan, str], dict[str, float]]


def origin(effect: str) -> str:
    """Return the origin of an effect: ``machine`` or ``instrument``."""
    return "instrument" if effect in INSTRUMENT else "machine"


def scaled(effect: Hidden, factor: float) -> Hidden:
    """Return an effect with its size multiplied by a factor."""
    own = {name: value if name in SHAPE else factor * value for name, value in effect.numbers.items()}
    return Hidden(effect.effect, effect.where, own)


def families(machine: TruthMachine, plan: Plan, *, further: bool = False) -> tuple[str, ...]:
    """Return the families possible on this machine: those in `FURTHER`, or all others."""
    return tuple(
        name for name, (places, _) in FAMILIES.items() if (name in FURTHER) is further and places(machine, plan)
    )


def drawn(rng: Rng, machine: TruthMachine, plan: Plan, family: str, size: float) -> Hidden | None:
    """Draw an effect of a family and scale it to a noncentrality; return None if no effect is visible in these data.

    Args:
        rng: the case's generator.
        machine: the machine.
        plan: the measurement plan.
        family: a name of `FAMILIES`.
        size: noncentrality λ after projecting out the set-up.
    """
    places, numbers = FAMILIES[family]
    where = places(machine, plan)
    silent = machine.readings(plan)
    for _ in range(PLACED):
        place = where[rng.integers(len(where))]
        effect = Hidden(family, place, numbers(rng, machine, plan, place))
        change = machine.readings(plan, [effect]) - silent
        raw = float(np.sum((change / machine.sigma_mm) ** 2))
        seen = machine.noncentrality(plan, change)
        if seen <= LEAST_LEFT * raw or raw == 0.0:
            continue
        for _ in range(ITERATIONS):
            effect = scaled(effect, float(np.sqrt(size / seen)))
            change = machine.readings(plan, [effect]) - silent
            seen = machine.noncentrality(plan, change)
        if np.abs(change).max() < LARGEST_MM:
            return effect
    return None


def two(rng: Rng, machine: TruthMachine, plan: Plan, size: float) -> list[Hidden]:
    """Return two effects of different families, each of which keeps `ALONE` of its λ if the other is fitted."""
    names = families(machine, plan)
    silent = machine.readings(plan)
    for _ in range(PLACED):
        found = [drawn(rng, machine, plan, str(name), size) for name in rng.choice(np.array(names), 2, replace=False)]
        pair = [effect for effect in found if effect is not None]
        if len(pair) < 2:
            continue
        changes = [machine.readings(plan, [one]) - silent for one in pair]
        first, second = (machine.left_over(plan, one) for one in changes)
        alike = float((first @ second) ** 2 / ((first @ first) * (second @ second)))
        # Neither may be a special form of the other, as a constant is of a curve.
        alike = max(
            alike,
            *(
                shares(machine, plan, change).get(other.key, 0.0)
                for change, other in zip(changes, pair[::-1], strict=True)
            ),
        )
        if alike < ALONE:
            return pair
    raise ValueError(f"no two effects of {machine.name} are distinguishable")


def _linear(machine: TruthMachine) -> list[str]:
    return [axis.name for axis in machine.axes if axis.linear]


def _rotary(machine: TruthMachine) -> list[str]:
    return [axis.name for axis in machine.axes if not axis.linear]


def _normal(*names: str) -> Draw:
    return lambda rng, machine, plan, where: {name: float(rng.standard_normal()) for name in names}


def _positive(*names: str) -> Draw:
    return lambda rng, machine, plan, where: {name: float(abs(rng.standard_normal())) for name in names}


def _span(machine: TruthMachine, name: str) -> float:
    return next(axis.high - axis.low for axis in machine.axes if axis.name == name)


def _pitch(rng: Rng, machine: TruthMachine, plan: Plan, where: str) -> dict[str, float]:
    period = 1.0 / rng.uniform(3.0 / _span(machine, where), 1.0 / SHORTEST_PERIOD)
    return {"amplitude": 1.0, "period": float(period), "phase": float(rng.uniform(-np.pi, np.pi))}


def _curve(rng: Rng, machine: TruthMachine, plan: Plan, where: str) -> dict[str, float]:
    """Return powers of u in the calibration's datum: no constant, and no slope for a straightness."""
    straight = where[2] in "XYZ" and where[2:] not in _along(machine)
    first = 2 if straight else 1
    sums = np.zeros(int(rng.integers(first, LONGEST_CURVE + 1)) + 1)
    sums[first:] = rng.standard_normal(len(sums) - first)
    return {f"c{k}": float(value) for k, value in enumerate(legendre.leg2poly(sums))}


def _along(machine: TruthMachine) -> list[str]:
    """Return direction and axis of every positioning error: ``XX``, ``YY``."""
    letters = {name: "XYZ"[int(np.argmax(np.abs(machine.direction(name))))] for name in _linear(machine)}
    return [letter + name for name, letter in letters.items()]


def _harmonic(rng: Rng, machine: TruthMachine, plan: Plan, where: str) -> dict[str, float]:
    order = float(rng.integers(1, HIGHEST_ORDER + 1))
    return {"order": order, "cos": float(rng.standard_normal()), "sin": float(rng.standard_normal())}


def _creep(rng: Rng, machine: TruthMachine, plan: Plan, where: str) -> dict[str, float]:
    span = float(np.ptp(plan.time_s))
    constant = np.exp(rng.uniform(np.log(span / 20.0), np.log(span)))
    return {"amplitude": float(rng.choice([-1.0, 1.0])), "time_constant": float(constant)}


def _reversal_curve(rng: Rng, machine: TruthMachine, plan: Plan, where: str) -> dict[str, float]:
    """Return a constant plus a larger varying part; a constant alone is a reversal."""
    sums = np.array([*rng.uniform(-0.5, 0.5, 1), *rng.choice([-1.0, 1.0], 1), *rng.standard_normal(rng.integers(3))])
    return {f"c{k}": float(value) for k, value in enumerate(legendre.leg2poly(sums))}


def _lag(name: str) -> Draw:
    def draw(rng: Rng, machine: TruthMachine, plan: Plan, where: str) -> dict[str, float]:
        span = float(np.ptp(plan.time_s))
        constant = float(np.exp(rng.uniform(np.log(span / 20.0), np.log(span / 3.0))))
        bent = {"exponent": float(rng.uniform(1.0, 2.0))} if name == "amplitude" else {}
        return {name: float(rng.choice([-1.0, 1.0])), **bent, "time_constant": constant}

    return draw


def _coupled(machine: TruthMachine, plan: Plan) -> list[str]:
    names = _linear(machine)
    return [f"E_{letter}{name} by {by}" for name in names for by in names if by != name for letter in "XYZABC"]


def _later(plan: Plan) -> list[str]:
    return list(dict.fromkeys(plan.round.tolist()))[1:]


def _tool_side(machine: TruthMachine) -> bool:
    return any(axis.side == "tool" for axis in machine.axes)


FAMILIES: dict[str, tuple[Where, Draw]] = {
    "reversal": (lambda m, p: [axis.name for axis in m.axes], _normal("size")),
    "reversal_curve": (lambda m, p: [axis.name for axis in m.axes if not axis.endless], _reversal_curve),
    "zero_offset": (lambda m, p: [axis.name for axis in m.axes], _normal("offset")),
    "pitch_error": (lambda m, p: _linear(m), _pitch),
    "squareness": (lambda m, p: list(m.squareness), _normal("angle")),
    "axis_location": (lambda m, p: list(m.locations), _normal("offset")),
    "positioning": (lambda m, p: [f"E_{name}" for name in _along(m)], _curve),
    "straightness": (
        lambda m, p: [f"E_{a}{name}" for name in _linear(m) for a in "XYZ" if a + name not in _along(m)],
        _curve,
    ),
    "angular_error_motion": (lambda m, p: [f"E_{a}{name}" for name in _linear(m) for a in "ABC"], _curve),
    "harmonic": (lambda m, p: [f"E_{a}{name}" for name in _rotary(m) for a in "XYZABC"], _harmonic),
    "thermal_expansion": (lambda m, p: [name for name in _linear(m) if name in p.warm], _normal("coefficient")),
    "thermal_growth": (
        lambda m, p: [f"{a} by {sensor}" for a in "XYZ" for sensor in p.warm if _tool_side(m)],
        _normal("coefficient"),
    ),
    "thermal_lag": (
        lambda m, p: [f"{a} by {sensor}" for a in "XYZ" for sensor in p.warm if _tool_side(m)],
        _lag("coefficient"),
    ),
    "spindle_growth": (lambda m, p: list("XYZ") if "spindle_rpm" in p.channels else [], _lag("amplitude")),
    "thermal_drift": (lambda m, p: list("XYZ") if _tool_side(m) else [], _creep),
    "cross_axis": (_coupled, _normal("coefficient")),
    "table_load": (lambda m, p: list(m.drooping), _normal("tilt")),
    "gravity_compliance": (lambda m, p: list(m.loaded), _positive("compliance")),
    "frame_shift": (
        lambda m, p: [f"round {name}" for name in _later(p)],
        _normal("shift_x", "shift_y", "shift_z", "turn_x", "turn_y", "turn_z"),
    ),
    "target_shift": (
        lambda m, p: [f"{target} from round {name}" for target in np.unique(p.target) for name in _later(p)],
        _normal("shift_x", "shift_y", "shift_z"),
    ),
    "station_drift": (lambda m, p: np.unique(p.station).tolist(), _normal("rate_x", "rate_y", "rate_z")),
    "affine_scale": (
        lambda m, p: [f"round {name}" for name in _later(p)[-1:]],
        _normal("scale_x", "scale_y", "scale_z", "shear_xy", "shear_xz", "shear_yz"),
    ),
    "refraction_scale": (lambda m, p: ["—"], _normal("scale")),
}
"""For every family: its possible locations on a machine in these data, and a function that draws its parameters."""
