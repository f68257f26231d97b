"""Truth machines as serial chains, in plain numpy from the conventions of the documentation.

Units: mm and radians; errors in mm and radians.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

import numpy as np

from tests.scored_cases.plan import Plan, TruthAxis
from tests.truth import hidden
from tests.truth.any_machine import TruthMachine, spindle
from tests.truth.hidden import STATIONS, Hidden

LETTERS = "XYZABC"
UM, URAD = 1e-3, 1e-6


@dataclass(frozen=True, eq=False)
class Link:
    """One axis of a side, from the base outwards.

    Attributes:
        axis: its name.
        before: (4, 4) from the end of the link before it to its error frame, at zero.
        linear: whether it is linear.
        direction: (3,) of its command, in the error frame.
        zero: command at which the joint is at zero, mm.
    """

    axis: str
    before: np.ndarray
    linear: bool
    direction: np.ndarray
    zero: float = 0.0


class Errors:
    """Six error components of every axis and of its location, for n rows.

    Args:
        machine: the machine.
        plan: what is measured.
    """

    def __init__(self, machine: Chain, plan: Plan) -> None:
        self._machine = machine
        self._plan = plan
        n = len(plan)
        self.motion = {axis.name: np.zeros((n, 6)) for axis in machine.axes}
        self.location = {axis.name: np.zeros(6) for axis in machine.axes}

    def add(self, effect: Hidden) -> None:
        """Add one named effect; those of the instrument act elsewhere."""
        v, where, plan = effect.numbers, effect.where, self._plan
        if effect.effect == "reversal":
            self._along(where, 0.5 * v["size"] * plan.approach_of(where))
        elif effect.effect == "reversal_curve":
            self._along(where, 0.5 * plan.approach_of(where) * self._powers(where, v))
        elif effect.effect == "zero_offset":
            self._along(where, np.full(len(plan), v["offset"]))
        elif effect.effect == "pitch_error":
            self._along(where, v["amplitude"] * np.sin(2 * np.pi * plan.at(where) / v["period"] + v["phase"]))
        elif effect.effect == "thermal_expansion":
            self._along(where, v["coefficient"] * (plan.warm[where] - 20.0) * plan.at(where) * 1e-3)
        elif effect.effect == "squareness":
            axis = where[4:]
            turn = np.eye(3)["ABC".index(where[2])]
            lever = np.cross(turn, self._machine.link(axis).direction)
            self.motion[axis][:, :3] += URAD * v["angle"] * plan.at(axis)[:, None] * lever
        elif effect.effect == "axis_location":
            self.location[where[4:]][LETTERS.index(where[2])] += _size(where) * v["offset"]
        elif effect.effect in ("positioning", "straightness", "angular_error_motion"):
            self._component(where, self._powers(where[3:], v))
        elif effect.effect == "harmonic":
            angle = v["order"] * np.radians(plan.at(where[3:]))
            self._component(where, v["cos"] * np.cos(angle) + v["sin"] * np.sin(angle))
        elif effect.effect == "cross_axis":
            name, by = where.split(" by ")
            own = plan.at(name[3:]) * 1e-3 if name[2] in "XYZ" else 1.0
            self._component(name, v["coefficient"] * own * plan.at(by) * 1e-3)
        elif effect.effect == "table_load":
            # The base's x is the error frame's.
            self.motion[where][:, 3] += URAD * v["tilt"] * np.sin(np.radians(plan.at(where)))

    def _powers(self, name: str, v: Mapping[str, float]) -> np.ndarray:
        axis = next(one for one in self._machine.axes if one.name == name)
        u = (2 * self._plan.at(name) - axis.low - axis.high) / (axis.high - axis.low)
        return np.asarray(sum(v[power] * u ** int(power[1:]) for power in v))

    def _along(self, axis: str, value: np.ndarray) -> None:
        """Add µm or µrad along the command."""
        link = self._machine.link(axis)
        first, size = (0, UM) if link.linear else (3, URAD)
        self.motion[axis][:, first : first + 3] += size * value[:, None] * link.direction

    def _component(self, name: str, value: np.ndarray) -> None:
        self.motion[name[3:]][:, LETTERS.index(name[2])] += _size(name) * value


def _size(name: str) -> float:
    return UM if name[2] in "XYZ" else URAD


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Chain(TruthMachine):
    """A machine of two serial chains from the same base.

    Attributes:
        sides: the axes of the tool side and of the work side, from the base outwards, and (4, 4) each side's frame at the end.
        targets: name → side and place in that frame, mm.
        home: positions of the axes at rest during a run.
        rounds, stops, poses: numbers of the plan.
        sensors: temperature sensors.
        has_spindle: whether the table has a column of spindle speeds.
        places_known: whether the table gives the targets' places. For a single axis, nothing else determines the directions across it.
        write: writes the machine file and the URDF into a folder.
    """

    name: str
    axes: tuple[TruthAxis, ...]
    sides: Mapping[str, tuple[tuple[Link, ...], np.ndarray]]
    targets: Mapping[str, tuple[str, tuple[float, float, float]]]
    home: tuple[float, ...]
    bundled: str = ""
    sigma_mm: float = 3e-3
    squareness: tuple[str, ...] = ()
    locations: tuple[str, ...] = ()
    drooping: tuple[str, ...] = ()
    loaded: tuple[str, ...] = ()
    rounds: int = 3
    stops: int = 11
    poses: int = 200
    sensors: tuple[str, ...] = ("bed",)
    has_spindle: bool = False
    places_known: bool = False
    write: Callable[[Path], Path] | None = None

    def write_machine(self, folder: Path) -> Path:
        if self.write is None:
            raise ValueError(f"{self.name} is bundled")
        return self.write(folder)

    def link(self, axis: str) -> Link:
        """Return the link of an axis."""
        return next(link for links, _ in self.sides.values() for link in links if link.axis == axis)

    def direction(self, axis: str) -> np.ndarray:
        """Return the direction of a linear axis; all of these machines have error frames that are parallel to the base."""
        return self.link(axis).direction

    def _readings(self, plan: Plan, effects: Sequence[Hidden], moved: np.ndarray) -> np.ndarray:
        errors = Errors(self, plan)
        place = self.places(plan)
        for effect in effects:
            errors.add(effect)
            if effect.effect == "target_shift":
                name, number = effect.where.split(" from round ")
                rows = (plan.target == name) & (plan.round.astype(int) >= int(number))
                place = place + UM * rows[:, None] * np.array([effect.numbers[f"shift_{a}"] for a in "xyz"])
        return hidden.read(plan, self._points(plan, errors, place) + moved, effects)

    def set_up(self, plan: Plan) -> np.ndarray:
        base = self._points(plan, Errors(self, plan), self.places(plan))
        origin = np.array([STATIONS[name][0] for name in plan.station])
        into = rotations(np.array([STATIONS[name][1] for name in plan.station])).transpose(0, 2, 1)
        columns = []
        for along in np.eye(3):
            every = np.broadcast_to(along, base.shape)
            moved = [] if self.places_known else [(plan.target, self.carried(plan, along))]
            for names, change in (
                *moved,
                (plan.station, every),
                (plan.station, np.cross(every, base - origin)),
            ):
                seen = np.einsum("nij,nj->ni", into, change)
                columns += [seen * (names == name)[:, None] for name in np.unique(names)]
        return np.stack(columns, axis=2).reshape(3 * len(plan), -1)

    def carried(self, plan: Plan, vector: np.ndarray) -> np.ndarray:
        none = Errors(self, plan)
        every = np.broadcast_to(vector, (len(plan), 3))
        return self._points(plan, none, every) - self._points(plan, none, np.zeros((len(plan), 3)))

    def places(self, plan: Plan) -> np.ndarray:
        return np.array([self.targets[name][1] for name in plan.target])

    def _points(self, plan: Plan, errors: Errors, place: np.ndarray) -> np.ndarray:
        """Return (n, 3) the targets in the base, mm."""
        found = np.zeros((len(plan), 3))
        for side, (links, end) in self.sides.items():
            rows = plan.carrier == side
            point = place[rows] @ end[:3, :3].T + end[:3, 3]
            for link in reversed(links):
                six, q = errors.motion[link.axis][rows], plan.at(link.axis)[rows]
                if link.linear:
                    point = (q - link.zero)[:, None] * link.direction + six[:, :3] + _turned(six[:, 3:], point)
                else:
                    point = _turned(np.radians(q)[:, None] * link.direction, point)
                    point = six[:, :3] + _turned(six[:, 3:], point)
                    located = errors.location[link.axis]
                    point = located[:3] + _turned(np.tile(located[3:], (len(q), 1)), point)
                point = point @ link.before[:3, :3].T + link.before[:3, 3]
            found[rows] = point
        return found

    def plan(self, rng: np.random.Generator) -> Plan:
        """Return runs of each axis back and forth, then poses of all axes, the same in every round."""
        low, high = (np.array([getattr(axis, end) for axis in self.axes]) for end in ("low", "high"))
        drawn = rng.uniform(low, high, (self.poses, len(self.axes)))
        q, approach, target, number = [], [], [], []
        for k in range(self.rounds):
            # Every round begins by homing all axes from below.
            now, came = np.array(self.home), np.ones(len(self.axes))
            for pose, names, forced in self._stops(drawn):
                moved = np.sign(pose - now)
                came = np.where(moved != 0.0, moved, came)
                if forced is not None:
                    came[forced[0]] = forced[1]
                now = pose
                for name in names:
                    q.append(pose)
                    approach.append(came)
                    target.append(name)
                    number.append(str(k + 1))
        time = hidden.STEP_S * np.arange(len(q))
        warm = {
            name: 20.0 + rng.uniform(1.5, 3.0) * (1.0 - np.exp(-time / 4000.0)) + 0.3 * np.sin(time / 1500.0 + 2.0 * i)
            for i, name in enumerate(self.sensors)
        }
        found = Plan(
            self.axes,
            np.round(np.array(q), 3),
            np.array(approach),
            np.array(target),
            np.array([self.targets[name][0] for name in target]),
            np.full(len(q), "1"),
            np.array(number),
            time,
            {name: np.round(values, 3) for name, values in warm.items()},
            spindle(time) if self.has_spindle else {},
        )
        if not self.places_known:
            return found
        return replace(found, channels={f"place_{a}_mm": self.places(found)[:, i] for i, a in enumerate("xyz")})

    def _stops(self, drawn: np.ndarray) -> list[tuple[np.ndarray, list[str], tuple[int, float] | None]]:
        """Return the poses of one round, the targets read at each, and a direction of approach that the run ensures."""
        found: list[tuple[np.ndarray, list[str], tuple[int, float] | None]] = []
        for i, axis in enumerate(self.axes):
            # An endless axis stops before its initial position.
            places = np.linspace(axis.low, axis.high, self.stops + axis.endless)[: self.stops]
            own = [name for name, (side, _) in self.targets.items() if side == axis.side]
            for run, sign in ((places, 1.0), (places[::-1], -1.0)):
                for j, place in enumerate(run):
                    pose = np.array(self.home)
                    pose[i] = place
                    found.append((pose, [own[(j + k) % len(own)] for k in (0, 1)], (i, sign)))
        for j, pose in enumerate(drawn):
            sides = {side: [n for n, (own, _) in self.targets.items() if own == side] for side in self.sides}
            found.append((pose, [names[j % len(names)] for names in sides.values() if names], None))
        return found


def rotations(vectors: np.ndarray) -> np.ndarray:
    """Return (n, 3, 3) rotations of rotation vectors, by Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = (vectors / np.maximum(angle[:, 0], 1e-300)).T
    o = np.zeros_like(x)
    cross = np.stack([o, -z, y, z, o, -x, -y, x, o], axis=1).reshape(-1, 3, 3)
    return np.eye(3) + np.sin(angle) * cross + 2.0 * np.sin(angle / 2.0) ** 2 * cross @ cross


def _turned(vectors: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.einsum("nij,nj->ni", rotations(vectors), points)
