"""Measured points against a calibration: what is left of them, and what they say of each error motion at each stop.

Stations and targets of unknown place are fitted, nothing else (`twin.diagnosis.problem.readings`). A point of a curve is the curve's
value and what the readings there would change it by, everything else held (component plus residual, as in regression diagnostics:
Larsen and McCleary 1972); with the 95 % interval from the readings' own scatter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import locked
from twin._common.json_form import json_form
from twin._common.units import UM
from twin.diagnosis.candidates.signatures import first_component
from twin.diagnosis.problem.readings import readings
from twin.diagnosis.wording.panels import groups_of, means
from twin.identification.network import Network
from twin.identification.setup import SetUp
from twin.identification.solve import solve
from twin.identification.unknowns import Unknowns
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.conditions import APPROACH, asked
from twin.machine.effects import Effect, split_name, unit_of
from twin.machine.machine import Machine
from twin.measurement.table import Measurements, state_of

LEGIBLE: Final = 5.0
"""Times the largest value of a curve beyond which an interval says nothing of it."""
FEWEST: Final = 3
"""Positions of an axis below which there is no curve to be seen."""
NO_SIDE: Final = 0


@final
@dataclass(frozen=True)
class Stops:
    """What the readings say of one error motion, stop by stop.

    Attributes:
        name: ISO 230-1 name.
        side: +1 or −1: of readings come to from below or above; 0: of all.
        position: (k,) mm or degrees.
        value: (k,) µm or µrad.
        half: (k,) half width of the 95 % interval.
    """

    name: str
    side: int
    position: np.ndarray
    value: np.ndarray
    half: np.ndarray

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"name": self.name, "unit": unit_of(self.name)} | json_form(self, rename={"half": "half_95"})


@final
@dataclass(frozen=True)
class Checked:
    """One table of measured points.

    Attributes:
        source: the file.
        points: how many; all are shown, those that are too far off to be chance as well.
        far: how many are, with this calibration; the set-up was fitted to the others.
        rms_before_um: of what is left of the coordinates read, the machine taken as drawn.
        rms_after_um: the same with the calibration.
        scatter: how the readings scatter by themselves, in words.
        before_um, after_um: (n,) distance of each point from where it is expected, or its length's.
        stops: by error motion.
        rows: set aside, line and reason.
        notices: what the file says of itself.
        left_out: effects that need a channel the table has not.
    """

    source: str
    points: int
    far: int
    rms_before_um: float
    rms_after_um: float
    scatter: str
    before_um: np.ndarray
    after_um: np.ndarray
    stops: Mapping[str, tuple[Stops, ...]]
    rows: tuple[tuple[int, str], ...]
    notices: tuple[str, ...]
    left_out: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        told = json_form(self, rename={"source": "file", "far": "too_far_off", "rows": "set_aside"})
        return told | {
            "stops": [stop.to_dict() for stops in self.stops.values() for stop in stops],
            "set_aside": [{"line": line, "reason": reason} for line, reason in self.rows],
        }


def checked(data: Measurements, machine: Machine, calibration: Calibration, path: Path) -> Checked:
    """Fit the set-up to measured points with a calibration held, and see what is left.

    Args:
        data: the measurements.
        machine: the machine.
        calibration: held as it is.
        path: where the data come from.

    Raises:
        InputError: data that cannot be a measurement of this machine, or outside the calibration's curves.
    """
    given = state_of(data, machine)
    needed = asked(calibration.effects, machine)
    absent = {name for channel, by in needed.items() if channel not in given for name in by}
    held = calibration.where(lambda name: name not in absent)
    kept = {effect.name for effect in held.effects}
    placed = readings(data, machine, held)
    network, good = placed.network, ~placed.bad
    none = Network(machine, network.data, network.instrument, Unknowns(machine, (), ()), None, network.covariance)
    drawn = solve(none, np.zeros(0), placed.setup, good.astype(float)).setup
    every = np.arange(len(network.data))
    before = none.difference(np.zeros(0), drawn, every)
    left = network.difference(np.zeros(0), placed.setup, every)
    read = network.read
    return Checked(
        source=str(path),
        points=len(every),
        far=int(np.count_nonzero(placed.bad)),
        rms_before_um=_rms(before, read),
        rms_after_um=_rms(left, read),
        scatter=placed.noise.source,
        before_um=locked(np.linalg.norm(before, axis=1) / UM),
        after_um=locked(np.linalg.norm(left, axis=1) / UM),
        stops=MappingProxyType(_stops(network, placed.setup, held)),
        rows=tuple((note.line, note.text) for note in network.data.set_aside),
        notices=network.data.notices,
        left_out=tuple(effect.name for effect in calibration.effects if effect.name not in kept),
    )


def _rms(left: np.ndarray, read: np.ndarray) -> float:
    return float(np.sqrt(np.mean(left[read] ** 2))) / UM


def _stops(network: Network, setup: SetUp, calibration: Calibration) -> dict[str, tuple[Stops, ...]]:
    machine, data = network.machine, network.data
    view = network.view(np.zeros(0), setup, np.arange(len(data)))
    state = state_of(data, machine)
    found: dict[str, tuple[Stops, ...]] = {}
    for name in machine.motion_names:
        component, _, axis = split_name(name)
        q = state[axis]
        if len(np.unique(np.round(q, 3))) < FEWEST:
            continue
        derivative = view.by_error[:, :, first_component(machine, axis) + component]
        weight = np.einsum("ni,ni->n", derivative, derivative)
        if not np.any(weight > 0.0):
            continue
        safe = np.where(weight > 0.0, weight, 1.0)
        off = np.einsum("ni,ni->n", derivative, view.residual) / safe / UM
        # The side of approach is in the value of the curve at each reading already.
        effects = [one for one in calibration.effects if is_motion(one, axis, calibration)]
        value = summed(effects, state, component)
        side = state.get(f"{APPROACH}{axis}", np.zeros(len(q)))
        both = bool(np.any(side > 0) and np.any(side < 0))
        parts = [_of_side(name, way, q, value + off, weight, np.sign(side) == way) for way in ((1, -1) if both else ())]
        parts = [part for part in parts if len(part.position)] or [
            _of_side(name, NO_SIDE, q, value + off, weight, np.ones(len(q), dtype=bool))
        ]
        found[name] = tuple(parts)
    return found


def reach(kinematics: Kinematics) -> np.ndarray:
    """(axes, 2) ranges as far as the curves are defined, mm and degrees; of an axis without limits one turn."""
    ranges, domains = np.array([axis.domain for axis in kinematics.machine.axes]), kinematics.calibration.domains()
    return np.stack([np.maximum(ranges[:, 0], domains[:, 0]), np.minimum(ranges[:, 1], domains[:, 1])], axis=1)


def is_motion(effect: Effect, axis: str, calibration: Calibration) -> bool:
    """Whether an effect is a motion of an axis; squareness, a line, is told by its angle."""
    own = effect.frame.axis == axis and effect.frame.role == "motion"
    return own and effect.name not in calibration.squareness


def summed(effects: Sequence[Effect], state: Mapping[str, Any], component: int) -> np.ndarray:
    """(n,) what effects make together of one component, µm or µrad, in n states."""
    count = len(next(iter(state.values())))
    parts = (effect.components(state).get(component, 0.0) for effect in effects)
    return np.asarray(sum(parts, np.zeros(count)), dtype=float)


def _of_side(name: str, side: int, q: np.ndarray, value: np.ndarray, weight: np.ndarray, rows: np.ndarray) -> Stops:
    rows = rows & (weight > 0.0)
    if np.count_nonzero(rows) < FEWEST:
        return Stops(name, side, np.zeros(0), np.zeros(0), np.zeros(0))
    at, mean, half = means(q[rows], value[rows], weight[rows], groups_of(q[rows]))
    said = half <= LEGIBLE * max(float(np.abs(mean).max(initial=0.0)), 1.0)
    return Stops(name, side, locked(at[said]), locked(mean[said]), locked(half[said]))
