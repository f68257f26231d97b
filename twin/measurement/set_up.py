"""Poses of the stations and places of the targets, and their initial values from the nominal machine.

The initial values are estimated by a robust loss that a few wrong rows do not affect.
A tracker's reading y of a target at place t, carried to b + A·t, from a station with pose (R, o) satisfies R·y + o − A·t = b. That is
linear in the nine entries of R, in o and in t; the nearest rotation is taken, and the final estimate refines it. The lengths of a
tracking interferometer (eq. 26 of the thesis, multilateration) are linear in the station's parameters after squaring.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, Literal, NamedTuple, final

import numpy as np

from twin._common.units import DEG, MM
from twin.machine.machine import Machine
from twin.measurement.instruments import InstrumentSpecification, StationInstruments
from twin.measurement.observation import VERTICAL_M, CarriedTargets, nominal_carriers, of_angles
from twin.measurement.table import Measurements
from twin.numerics.spatial import cross_matrix, rotation_exp

PLACE_PLAUSIBLE: Final = 0.2
"""Prior standard deviation of a target's place on its carrier if it is not given, m."""
STATION_PLAUSIBLE: Final = 10.0
"""Prior standard deviation of a station's position, m."""
TURN_PLAUSIBLE: Final = 1.0
"""Prior standard deviation of a station's rotation about its initial value, rad."""
LEVEL_PLAUSIBLE: Final = 1e-3
"""The same of a turn that no reading shows (`StationsAndTargets.level`), rad: 0.5 ppm of a length, 1 µrad of a right angle."""
IN_PLANE_M: Final = 1e-4
"""Largest distance from a plane, m, at which points are in it: times such a turn 0.1 µm."""


ALIGNED_TURN: Final = 1e-3
ALIGNED_SHIFT: Final = 5e-3
"""The same, rad and m, of a part whose program and measurement have nearly the same frame."""
TOOL_PLAUSIBLE: Final = 1e-4
"""Prior standard deviation of a tool's radius, of its length, and of its deflection, m."""
TOOL_SIZES: Final = ("radius", "length", "deflection")
SlotKind = Literal["turn", "origin", "dead path", "place", "tool"]


class Slot(NamedTuple):
    """Unknown parameters of one kind of one station or target.

    ``kind``: ``turn``, ``origin`` and ``dead path`` of a station, ``place`` of a target, ``tool``: sizes of a tool that cut.
    """

    kind: SlotKind
    number: int
    at: slice


@final
@dataclass(frozen=True)
class StationsAndTargets:
    """Poses of stations and places of targets; metres and radians, in the frame on which each station rides (usually the base frame).

    Attributes:
        rotation: (stations, 3, 3) station frame in that frame.
        origin: (stations, 3).
        dead: (stations,) dead path of an interferometer, at which its counter was zeroed; zero where lengths are absolute.
        place: (targets, 3) on their carriers.
        station_known, target_known: whether the table gives the pose or place.
        lines: (targets,) whether a target is a line of 1 m that turns with a level; its unknowns are x and y of its end.
        level: (stations, 3) turns out of a plane that the readings are in, where the coordinate across it was not read. They show to
            second order only: two of them as a squareness, one as a scale. The plane is taken to be that of the points.
        tools: names of the tools that cut measured points.
        tool: (tools, 3) deviation of their radius and length, m, and deflection by one unit of engagement, m (`TOOL_SIZES`).
        tool_acts: (tools, 3) whether any reading depends on it.
        station_acts: (stations, 6) whether each component of a station's rotation and origin is unknown. A motion of a part that its
            points do not show stays zero: as a large one it would deform what they show.
        shift: (unknowns,) change of each parameter by `moved` since its initial value, metres and radians; None for zero.
    """

    stations: tuple[str, ...]
    rotation: np.ndarray
    origin: np.ndarray
    dead: np.ndarray
    targets: tuple[str, ...]
    place: np.ndarray
    station_known: np.ndarray
    target_known: np.ndarray
    reads: tuple[InstrumentSpecification, ...]
    lines: np.ndarray
    level: np.ndarray
    tools: tuple[str, ...] = ()
    tool: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    tool_acts: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), dtype=bool))
    station_acts: np.ndarray = field(default_factory=lambda: np.zeros((0, 6), dtype=bool))
    shift: np.ndarray | None = None

    @classmethod
    def from_table(cls, data: Measurements, instruments: StationInstruments) -> StationsAndTargets:
        """Return the poses and places given in a table; identity and zero for the others."""
        stations, first = _first_rows(data.station)
        targets, first_target = _first_rows(data.target)
        pose, place = data.station_pose[first], data.place_mm[first_target] * MM
        station_known = np.asarray(np.isfinite(pose).all(axis=1))
        target_known = np.asarray(np.isfinite(place).all(axis=1))
        rotation = rotation_exp(np.where(station_known[:, None], pose[:, 3:] * DEG, 0.0))
        origin = np.where(station_known[:, None], pose[:, :3] * MM, 0.0)
        place = np.where(target_known[:, None], place, 0.0)
        dead = np.zeros(len(stations))
        reads = tuple(instruments.by_station[name].specification for name in stations)
        lines = np.isin(targets, data.target[of_angles(data)].astype(str))
        place[lines & ~target_known] = VERTICAL_M
        level = np.zeros((len(stations), 3), dtype=bool)
        setup = cls(stations, rotation, origin, dead, targets, place, station_known, target_known, reads, lines, level)
        tools = tuple(name for name in dict.fromkeys(data.tool.tolist()) if name)
        acts = [(np.nan_to_num(data.by_tool[data.tool == name]) != 0.0).any(axis=0) for name in tools]
        return replace(
            setup,
            tools=tools,
            tool=np.zeros((len(tools), 3)),
            tool_acts=np.array(acts, dtype=bool).reshape(-1, 3),
            station_acts=np.ones((len(stations), 6), dtype=bool),
        )

    def of(self, data: Measurements) -> StationsAndTargets:
        """Return the stations and targets of other data, with the values of this set-up.

        Raises `KeyError`: a station or target that is not in this set-up.
        """
        named = dict.fromkeys(data.station.tolist()), dict.fromkeys(data.target.tolist())
        for name in (*(set(named[0]) - set(self.stations)), *(set(named[1]) - set(self.targets))):
            raise KeyError(name)
        stations = [self.stations.index(name) for name in named[0]]
        targets = [self.targets.index(name) for name in named[1]]
        tools = [i for i, name in enumerate(self.tools) if np.any(data.tool == name)]
        return replace(
            self,
            stations=tuple(named[0]),
            rotation=self.rotation[stations],
            origin=self.origin[stations],
            dead=self.dead[stations],
            reads=tuple(self.reads[i] for i in stations),
            lines=self.lines[targets],
            level=self.level[stations],
            targets=tuple(named[1]),
            place=self.place[targets],
            station_known=self.station_known[stations],
            target_known=self.target_known[targets],
            tools=tuple(self.tools[i] for i in tools),
            tool=self.tool[tools],
            tool_acts=self.tool_acts[tools],
            station_acts=self.station_acts[stations],
            shift=None,
        )

    def indices(self, data: Measurements) -> tuple[np.ndarray, np.ndarray]:
        """Return (n,) station and (n,) target of each row of some data, as indices."""
        stations, targets = ({name: i for i, name in enumerate(names)} for names in (self.stations, self.targets))
        return (
            np.array([stations[name] for name in data.station], dtype=int),
            np.array([targets[name] for name in data.target], dtype=int),
        )

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def slots(self) -> tuple[Slot, ...]:
        """Unknown parameters of each station, then of each target."""
        slots: list[Slot] = []

        def add(kind: SlotKind, number: int, count: int = 3) -> None:
            start = slots[-1].at.stop if slots else 0
            if not count:
                return
            slots.append(Slot(kind, number, slice(start, start + count)))

        for i, (known, reads) in enumerate(zip(self.station_known.tolist(), self.reads, strict=True)):
            if reads.turns and not known:
                add("turn", i, int(self.acts("turn", i).sum()))
            if not known:
                add("origin", i, int(self.acts("origin", i).sum()))
            if reads.free_start:
                add("dead path", i, 1)
        for i in np.flatnonzero(~self.target_known).tolist():
            add("place", i, 2 if self.lines[i] else 3)
        for i, acts in enumerate(self.tool_acts):
            add("tool", i, int(np.count_nonzero(acts)))
        return tuple(slots)

    def acts(self, kind: SlotKind, number: int) -> np.ndarray:
        """Return (3,) which components of a station's rotation (``turn``) or origin are unknown."""
        return self.station_acts[number, :3] if kind == "turn" else self.station_acts[number, 3:]

    def by_tool(self, data: Measurements, number: int) -> np.ndarray:
        """Return (n, k) change of the readings by the k sizes of one tool that act; zero for points that it did not cut."""
        own = (data.tool == self.tools[number])[:, None]
        return np.where(own, np.nan_to_num(data.by_tool), 0.0)[:, self.tool_acts[number]]

    def tool_offset(self, data: Measurements, rows: np.ndarray) -> np.ndarray:
        """Return (k,) the change of some readings by the sizes of the tools that cut, m."""
        offset = np.zeros(len(rows))
        for name, sizes in zip(self.tools, self.tool, strict=True):
            offset += np.where(data.tool[rows] == name, np.nan_to_num(data.by_tool[rows]) @ sizes, 0.0)
        return offset

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the unknown parameters, in the order of `moved`."""
        names: list[str] = []
        for kind, i, at in self.slots:
            if kind == "dead path":
                names.append(f"station {self.stations[i]} dead path")
                continue
            if kind == "tool":
                names += [
                    f"tool {self.tools[i]} {size}"
                    for size, acts in zip(TOOL_SIZES, self.tool_acts[i], strict=True)
                    if acts
                ]
                continue
            what = f"target {self.targets[i]}" if kind == "place" else f"station {self.stations[i]}"
            axes = "xyz"[: at.stop - at.start]
            if kind in ("turn", "origin"):
                axes = "".join(axis for axis, one in zip("xyz", self.acts(kind, i), strict=True) if one)
            names += [f"{what} turn {axis}" if kind == "turn" else f"{what} {axis}" for axis in axes]
        return tuple(names)

    @property
    def plausible(self) -> np.ndarray:
        """Prior standard deviation of each unknown parameter, (unknowns,), metres and radians."""
        # The factor allows for a common shift of all targets of that size.
        place = PLACE_PLAUSIBLE * float(np.sqrt(max(int(np.count_nonzero(~self.target_known)), 1)))
        kinds = {"place": place, "turn": TURN_PLAUSIBLE, "tool": TOOL_PLAUSIBLE}
        sizes: list[float] = []
        for kind, i, at in self.slots:
            size = [kinds.get(kind, STATION_PLAUSIBLE)] * (at.stop - at.start)
            if kind in ("turn", "origin") and self.reads[i].aligned:
                size = [ALIGNED_TURN if kind == "turn" else ALIGNED_SHIFT] * (at.stop - at.start)
            elif kind == "turn":
                size = np.where(self.level[i], LEVEL_PLAUSIBLE, TURN_PLAUSIBLE).tolist()
            sizes += size
        return np.array(sizes)

    def moved(self, step: np.ndarray) -> StationsAndTargets:
        """Return the set-up after a step; rotations are rotation vectors in the station's own frame."""
        rotation, tool = np.array(self.rotation), np.array(self.tool)
        shifted = {"origin": np.array(self.origin), "dead path": np.array(self.dead), "place": np.array(self.place)}
        for kind, i, at in self.slots:
            if kind == "turn":
                turn = np.zeros(3)
                turn[self.acts(kind, i)] = step[at]
                rotation[i] = rotation[i] @ rotation_exp(turn)
            elif kind == "origin":
                shifted[kind][i, self.acts(kind, i)] += step[at]
            elif kind == "tool":
                tool[i, self.tool_acts[i]] += step[at]
            else:
                shifted[kind].reshape(len(shifted[kind]), -1)[i, : at.stop - at.start] += step[at]
        shift = step if self.shift is None else self.shift + step
        origin, dead, place = shifted.values()
        return replace(self, rotation=rotation, origin=origin, dead=dead, place=place, tool=tool, shift=shift)


def _first_rows(names: np.ndarray) -> tuple[tuple[str, ...], list[int]]:
    """Return the names in order of appearance, and the first row of each."""
    first: dict[str, int] = {}
    for row, name in enumerate(names):
        first.setdefault(name, row)
    return tuple(first), list(first.values())


# --- Initial values from the nominal machine -----------------------------------------------------------

FLOOR: Final = 1e-4
"""Misfit, m, below which all rows have the same weight: the order of the machine's own errors."""
LARGEST_MISFIT_M: Final = 5e-3
"""Deviation of a reading from the nominal machine, m, above which the row is wrong: no machine tool has such errors."""
RELATIVE_RANK: Final = 1e-3
"""Relative singular value below which the readings do not determine a direction."""
LEAST_ARM: Final = 2e-3
LEAST_SHIFT: Final = 1e-3
"""Change of all readings by a rotation of a part, m/rad, and by a shift, below which they do not determine it."""
SWEEPS: Final = 60
LARGEST_TURN: Final = 0.5
"""Largest rotation in one step, rad."""
LEAST_ROTATION: Final = 1e-10


def initial_setup(
    data: Measurements, instruments: StationInstruments, carried: CarriedTargets, *, mirrored: bool = False
) -> tuple[StationsAndTargets, np.ndarray]:
    """Return the set-up with which the readings follow their nominal carriers, and (n,) the misfit of each reading, metres.

    Stations that read points, lengths and angles are estimated each from their own rows.

    ``carried``: the carriers of the rows on the nominal machine; ``mirrored``: whether readings in a left-handed frame are accepted;
    they agree poorly.

    Raises `InputError`: a station with fewer than three points, or one whose readings are in a left-handed frame.
    """
    setup = StationsAndTargets.from_table(data, instruments)
    kinds = np.array([read.reads if read.reads in ("length", "angle") else "point" for read in setup.reads])
    directed = [np.isfinite(data.along[data.station == name]).any() for name in setup.stations]
    kinds = np.where(directed, "along", kinds)
    if len(set(kinds)) > 1:
        return _by_kind(data, instruments, carried, setup, kinds)
    station, target = setup.indices(data)
    if kinds[0] == "angle":
        return _by_angles(setup, carried, data, station)
    if kinds[0] == "along":
        return _by_directions(setup, carried, data, station, target)
    if kinds[0] == "length":
        length = np.where(np.isfinite(data.point_mm[:, 0]), data.point_mm[:, 0], 0.0) * MM
        return _by_lengths(setup, carried, length, station, target)
    return _by_points(setup, carried, data, station, target, mirrored=mirrored)


def turned_about_the_axis(
    machine: Machine, data: Measurements, setup: StationsAndTargets, angles: Sequence[float]
) -> list[StationsAndTargets]:
    """Return the set-up turned by some angles, rad, about the only axis that moved, a rotary one; else, or if a place is known, none.

    On a nominal machine, stations and targets turned together about that axis give the same readings, so that the nominal machine
    cannot tell where they are; only the axis's error motions can.
    """
    moved = np.flatnonzero(np.ptp(data.positions, axis=0) > 0.0)
    if len(moved) != 1 or machine.axes[moved[0]].linear or setup.station_known.any() or setup.target_known.any():
        return []
    carried = nominal_carriers(machine, data)
    first = [int(np.flatnonzero(data.target == name)[0]) for name in setup.targets]
    own = np.flatnonzero(data.target == data.target[first[0]])
    for name in setup.targets:
        rows = np.flatnonzero(data.target == name)
        if np.ptp(carried.rotation[rows], axis=0).max() > np.ptp(carried.rotation[own], axis=0).max():
            own = rows
    turn = carried.rotation[own] @ carried.rotation[own[0]].T
    shift = carried.points[own] - np.einsum("nij,j->ni", turn, carried.points[own[0]])
    far = int(np.argmin(np.trace(turn, axis1=1, axis2=2)))
    along = np.linalg.svd(turn[far] - np.eye(3))[2][2]
    centre = np.linalg.lstsq((np.eye(3) - turn).reshape(-1, 3), shift.reshape(-1), rcond=1e-9)[0]
    turned = []
    for angle in angles:
        by = rotation_exp(angle * along)
        points, rotation = carried.points[first], carried.rotation[first]
        at = centre + (points + np.einsum("nij,nj->ni", rotation, setup.place) - centre) @ by.T
        turned.append(
            replace(
                setup,
                rotation=by @ setup.rotation,
                origin=centre + (setup.origin - centre) @ by.T,
                place=np.einsum("nji,nj->ni", rotation, at - points),
            )
        )
    return turned


def _by_kind(
    data: Measurements,
    instruments: StationInstruments,
    carried: CarriedTargets,
    setup: StationsAndTargets,
    kinds: np.ndarray,
) -> tuple[StationsAndTargets, np.ndarray]:
    rotation, origin, level = np.array(setup.rotation), np.array(setup.origin), np.array(setup.level)
    dead, place = np.array(setup.dead), np.array(setup.place)
    miss, placed = np.zeros(len(data)), set()
    for kind in ("point", "length", "angle", "along"):
        names = np.array(setup.stations)[kinds == kind]
        if not len(names):
            continue
        rows = np.flatnonzero(np.isin(data.station.astype(str), names))
        of_kind, miss[rows] = initial_setup(data.select(rows), instruments, carried.select(rows))
        at = [setup.stations.index(name) for name in of_kind.stations]
        rotation[at], origin[at], dead[at], level[at] = of_kind.rotation, of_kind.origin, of_kind.dead, of_kind.level
        for target, name in enumerate(of_kind.targets):
            if name not in placed:
                place[setup.targets.index(name)] = of_kind.place[target]
                placed.add(name)
    return replace(setup, rotation=rotation, origin=origin, dead=dead, place=place, level=level), miss


def _by_angles(
    setup: StationsAndTargets, carried: CarriedTargets, data: Measurements, station: np.ndarray
) -> tuple[StationsAndTargets, np.ndarray]:
    """Return the set-up of levels: vertical lines on their carriers, and the mean reading as the origin of each station."""
    y = np.nan_to_num(data.point_mm) * MM
    off = carried.points - y
    origin = np.array([off[station == i].mean(axis=0) for i in range(len(setup.stations))])
    origin = np.where(setup.station_known[:, None], setup.origin, origin)
    miss = np.linalg.norm(np.where(np.isfinite(data.point_mm), off - origin[station], 0.0), axis=1)
    return replace(setup, origin=origin), miss


def reading_frames(data: Measurements) -> np.ndarray:
    """Return (n, 3, 3) the directions, in the station's frame, along which the coordinates of each reading were read."""
    frames = np.tile(np.eye(3), (len(data), 1, 1))
    for row in np.flatnonzero(np.isfinite(data.along).all(axis=1)):
        first = data.along[row] / np.linalg.norm(data.along[row])
        second = np.cross(first, np.eye(3)[np.abs(first).argmin()])
        second /= np.linalg.norm(second)
        frames[row] = first, second, np.cross(first, second)
    return frames


def _by_directions(
    setup: StationsAndTargets, carried: CarriedTargets, data: Measurements, station: np.ndarray, target: np.ndarray
) -> tuple[StationsAndTargets, np.ndarray]:
    """Return the set-up of parts, whose frames are nearly those on which they ride, from coordinates along directions; robust."""
    points, along = carried.at(setup.place[target]), reading_frames(data)[:, 0]
    reading = np.nan_to_num(data.point_mm[:, 0]) * MM
    rotation, origin = np.array(setup.rotation), np.array(setup.origin)
    misfit, acts = np.zeros(len(data)), np.array(setup.station_acts)
    for i in range(len(setup.stations)):
        rows = np.flatnonzero(station == i)
        acts[i] = _determined(np.hstack([np.cross(along[rows], points[rows] - points[rows].mean(axis=0)), along[rows]]))
        for _ in range(SWEEPS):
            seen = (points[rows] - origin[i]) @ rotation[i]
            residual = reading[rows] - np.einsum("ni,ni->n", along[rows], seen)
            misfit[rows] = np.abs(residual)
            if setup.station_known[i]:
                break
            weight = np.sqrt(FLOOR / np.maximum(misfit[rows], FLOOR))
            columns = np.hstack([np.cross(along[rows], seen), -along[rows] @ rotation[i].T]) * weight[:, None]
            scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
            step = np.zeros(6)
            own = acts[i]
            step[own] = np.linalg.lstsq((columns / scale)[:, own], residual * weight, rcond=1e-12)[0] / scale[own]
            step[:3] *= min(1.0, LARGEST_TURN / max(float(np.abs(step[:3]).max()), 1e-12))
            rotation[i], origin[i] = rotation[i] @ rotation_exp(step[:3]), origin[i] + step[3:]
            if np.abs(step).max() < LEAST_ROTATION:
                break
    return replace(setup, rotation=rotation, origin=origin, station_acts=acts), misfit


def _determined(columns: np.ndarray) -> np.ndarray:
    """Return (6,) which motions of a part its points determine, from derivatives (n, 6) by rotation and origin."""
    basis, acts = np.zeros((len(columns), 0)), np.zeros(6, dtype=bool)
    for k, least in (
        (3, LEAST_SHIFT),
        (4, LEAST_SHIFT),
        (5, LEAST_SHIFT),
        (2, LEAST_ARM),
        (1, LEAST_ARM),
        (0, LEAST_ARM),
    ):
        left = columns[:, k] - basis @ (basis.T @ columns[:, k])
        length = float(np.linalg.norm(left))
        if length > least:
            basis, acts[k] = np.column_stack([basis, left / length]), True
    return acts


@final
class _Equations:
    """Equations R·y + o − A·t = b of all rows, linear in the unknowns of the set-up: R and o of each station, t of each target.

    Args:
        setup: set-up with the poses and places that are given.
        point: (n, 3) readings, metres; zero for incomplete rows.
        whole: (n,) rows with every coordinate.
        carried: the carriers of the targets.
        station, target: (n,) indices.
    """

    def __init__(
        self,
        setup: StationsAndTargets,
        point: np.ndarray,
        whole: np.ndarray,
        carried: CarriedTargets,
        station: np.ndarray,
        target: np.ndarray,
    ) -> None:
        self.setup, self.whole, self.station, self.b = setup, whole, station, carried.points
        stations, rows = len(setup.stations), np.arange(len(point))
        # Centred by station, so that the position of points in a plane or line does not affect the rotation.
        self.centre = np.zeros((stations, 3))
        for i in range(stations):
            of = whole & (station == i)
            self.centre[i] = point[of].mean(axis=0) if np.any(of) else 0.0
        self.y = np.where(whole[:, None], point - self.centre[station], 0.0)
        self.matrix = np.zeros((len(point), 3, 12 * stations + 3 * len(setup.targets)))
        for i in range(3):
            for j in range(3):
                self.matrix[rows, i, 12 * station + 3 * i + j] = self.y[:, j]
                self.matrix[rows, i, 12 * stations + 3 * target + j] = -carried.rotation[:, i, j]
            self.matrix[rows, i, 12 * station + 9 + i] = 1.0
        self.known = np.concatenate([np.repeat(setup.station_known, 12), np.repeat(setup.target_known, 3)])
        origin = setup.origin + _rotate_each(setup.rotation, self.centre)
        poses = np.concatenate([setup.rotation.reshape(stations, 9), origin], axis=1)
        self.values = np.where(self.known, np.concatenate([poses.ravel(), setup.place.ravel()]), 0.0)
        self.station_unknowns = 12 * stations

    def solve(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (unknowns,) the robust linear estimate, with the entries of R independent of each other, and (n,) the weights."""
        weight, estimate = self.whole.astype(float), self.values
        for _ in range(SWEEPS):
            estimate = self._weighted(weight)
            misfit = np.linalg.norm(self.b - self.matrix @ estimate, axis=1)
            new_weight = np.where(self.whole, 1.0 / np.maximum(misfit, FLOOR), 0.0) * FLOOR
            if np.allclose(new_weight, weight, atol=1e-3):
                break
            weight = new_weight
        return estimate, weight

    def _weighted(self, weight: np.ndarray) -> np.ndarray:
        root, unknown = np.sqrt(weight)[:, None], ~self.known
        flat = (self.matrix[:, :, unknown] * root[:, :, None]).reshape(3 * len(self.y), -1)
        size = np.zeros(len(self.known))
        size[unknown] = np.linalg.norm(flat, axis=0)
        # The same scale for all entries of a rotation: across a plane of points there is only noise, which does not determine it.
        for i in range(0, self.station_unknowns, 12):
            size[i : i + 9] = size[i : i + 9].max()
        size = size[unknown]
        scale = np.where(size > 0.0, size, 1.0)
        # A motion along one line leaves undetermined directions, for which the smallest solution is taken.
        strength, directions = np.linalg.eigh((flat.T @ flat) / np.outer(scale, scale))
        seen = strength > RELATIVE_RANK**2 * strength[-1:]
        directions = directions[:, seen]
        right = ((self.b - self.matrix @ self.values) * root).ravel()
        weighted = np.array(self.values)
        weighted[unknown] = directions @ ((directions.T @ (flat.T @ right / scale)) / strength[seen]) / scale
        return weighted

    def with_fitted_rotations(self, rotation: np.ndarray, weight: np.ndarray) -> tuple[StationsAndTargets, np.ndarray]:
        """Return the set-up with rotations fitted as rotations, together with origins and places.

        The nearest rotation is not the best fit, and it is far from it where a motion along one line leaves entries undetermined.
        """
        setup, matrix, y, station = self.setup, self.matrix, self.y, self.station
        index = np.arange(matrix.shape[2])
        in_rotation = (index < self.station_unknowns) & (index % 12 < 9)
        linear = ~in_rotation & ~self.known
        values = np.where(in_rotation | linear, 0.0, self.values)
        free = np.flatnonzero(~setup.station_known)
        of_station = np.concatenate(
            [np.ones(3 * len(free), dtype=bool), np.flatnonzero(linear) < self.station_unknowns]
        )
        for _ in range(SWEEPS):
            right = self.b - np.einsum("nij,nj->ni", rotation[station], y) - matrix @ values
            by_turn = np.zeros((len(y), 3, 3 * len(free)))
            for k, i in enumerate(free.tolist()):
                of = station == i
                by_turn[of, :, 3 * k : 3 * k + 3] = -rotation[i] @ cross_matrix(y[of])
            root = np.sqrt(weight)[:, None]
            flat = (np.concatenate([by_turn, matrix[:, :, linear]], axis=2) * root[:, :, None]).reshape(3 * len(y), -1)
            scale = np.maximum(np.linalg.norm(flat, axis=0), 1e-12)
            # If only the sum of a station's origin and a target's place is determined, it is attributed to the station.
            solved = np.zeros(flat.shape[1])
            for part in (of_station, np.ones_like(of_station)):
                residual = (right * root).ravel() - flat @ solved
                solved[part] += np.linalg.lstsq(flat[:, part] / scale[part], residual, rcond=1e-9)[0] / scale[part]
            turned, solved = solved[: 3 * len(free)].reshape(-1, 3), solved[3 * len(free) :]
            turned *= min(1.0, LARGEST_TURN / max(float(np.abs(turned).max(initial=0.0)), 1e-12))
            for i, part in zip(free.tolist(), turned, strict=True):
                rotation[i] = rotation[i] @ rotation_exp(part)
            misfit = np.linalg.norm(right - matrix[:, :, linear] @ solved, axis=1)
            weight = np.where(self.whole, FLOOR / np.maximum(misfit, FLOOR), 0.0)
            if np.abs(turned).max(initial=0.0) < LEAST_ROTATION:
                break
        values[linear] = solved
        of_stations, place = np.split(values, [self.station_unknowns])
        origin = of_stations.reshape(-1, 12)[:, 9:] - _rotate_each(rotation, self.centre)
        origin = np.where(setup.station_known[:, None], setup.origin, origin)
        fitted = replace(setup, rotation=rotation, origin=origin, place=place.reshape(-1, 3))
        return fitted, np.where(self.whole, misfit, 0.0)


def _by_points(
    setup: StationsAndTargets,
    carried: CarriedTargets,
    data: Measurements,
    station: np.ndarray,
    target: np.ndarray,
    *,
    mirrored: bool,
) -> tuple[StationsAndTargets, np.ndarray]:
    point = _zero_for_unread(setup, data.point_mm, station)
    whole = np.isfinite(point).all(axis=1)
    for i, name in enumerate(setup.stations):
        if not setup.station_known[i] and np.count_nonzero(whole & (station == i)) < 3:
            raise data.error(
                f"station {name} has fewer than 3 points with all three coordinates, or with the same two",
                expected="more points of this station, or its pose in the station columns",
                row=int(np.flatnonzero(station == i)[0]),
            )
    equations = _Equations(setup, np.where(whole[:, None], point, 0.0) * MM, whole, carried, station, target)
    estimate, weight = equations.solve()
    rotation = _nearest_rotations(setup, estimate, data, station, mirrored=mirrored)
    fitted, misfit = equations.with_fitted_rotations(rotation, weight)
    return replace(fitted, level=_level(fitted, carried, data, station, target)), misfit


def _level(
    setup: StationsAndTargets, carried: CarriedTargets, data: Measurements, station: np.ndarray, target: np.ndarray
) -> np.ndarray:
    """Return (stations, 3) the turns out of the plane of a station that reads two coordinates of points in one plane."""
    level, points = np.zeros((len(setup.stations), 3), dtype=bool), carried.at(setup.place[target])
    for i in np.flatnonzero(~setup.station_known):
        of = station == i
        unread = ~np.isfinite(data.point_mm[of]).any(axis=0)
        if np.count_nonzero(unread) == 1:
            across = points[of] @ setup.rotation[i][:, unread]
            level[i] = ~unread & bool(np.ptp(across) < IN_PLANE_M)
    return level


def _nearest_rotations(
    setup: StationsAndTargets, estimate: np.ndarray, data: Measurements, station: np.ndarray, *, mirrored: bool
) -> np.ndarray:
    """Return (stations, 3, 3) the rotations nearest to the estimated entries; known rotations unchanged.

    Raises `InputError`: a station whose readings are in a left-handed frame, if these are not accepted.
    """
    rotation = np.array(setup.rotation)
    for i in np.flatnonzero(~setup.station_known):
        raw = estimate[12 * i : 12 * i + 9].reshape(3, 3)
        u, s, v = np.linalg.svd(raw)
        if not mirrored and np.linalg.det(raw) < 0.0 and s[2] > 0.5:
            raise data.error(
                f"readings of station {setup.stations[i]} are in a left-handed frame",
                expected="right-handed x_mm, y_mm, z_mm; two of the columns may be swapped, or one has the wrong sign",
                row=int(np.flatnonzero(station == i)[0]),
            )
        rotation[i] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return rotation


def _rotate_each(rotation: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.array([turn @ vector for turn, vector in zip(rotation, vectors, strict=True)])


def _zero_for_unread(setup: StationsAndTargets, point_mm: np.ndarray, station: np.ndarray) -> np.ndarray:
    """Return (n, 3) points, mm, with zero for coordinates that a station never read (readings in a plane or on a line)."""
    point = np.array(point_mm)
    for i in np.flatnonzero(~setup.station_known):
        of = np.flatnonzero(station == i)
        never = ~np.isfinite(point[of]).any(axis=0)
        point[np.ix_(of, np.flatnonzero(never))] = 0.0
    return point


def _by_lengths(
    setup: StationsAndTargets, carried: CarriedTargets, length: np.ndarray, station: np.ndarray, target: np.ndarray
) -> tuple[StationsAndTargets, np.ndarray]:
    origin, dead, points = np.array(setup.origin), np.array(setup.dead), carried.at(setup.place[target])
    for i in range(len(setup.stations)):
        rows = np.flatnonzero(station == i)
        if setup.station_known[i]:
            if setup.reads[i].free_start:
                dead[i] = np.median(np.linalg.norm(points[rows] - origin[i], axis=1) - length[rows])
            continue
        # From one target, so that on the tool side its unknown place only shifts the station.
        rows = rows[target[rows] == np.bincount(target[rows]).argmax()]
        origin[i], dead[i] = _multilateration(points[rows], length[rows], free_start=setup.reads[i].free_start)
    setup = replace(setup, origin=origin, dead=dead)
    for _ in range(SWEEPS):
        # A damped, robust Gauss-Newton step.
        beam = carried.at(setup.place[target]) - setup.origin[station]
        far = np.linalg.norm(beam, axis=1)
        unit = beam / far[:, None]
        misfit = length - (far - setup.dead[station])
        weight = np.sqrt(FLOOR / np.maximum(np.abs(misfit), FLOOR))
        along = np.einsum("ni,nij->nj", unit, carried.rotation)
        derivative = {"origin": -unit, "dead path": -np.ones((len(unit), 1)), "place": along}
        jacobian = np.zeros((len(length), len(setup)))
        for kind, i, at in setup.slots:
            rows = (target if kind == "place" else station) == i
            jacobian[rows, at] = derivative[kind][rows]
        scale = setup.plausible
        damped = np.concatenate([jacobian * weight[:, None] * scale, 1e-6 * np.eye(len(setup))])
        step = np.linalg.lstsq(damped, np.concatenate([misfit * weight, np.zeros(len(setup))]), rcond=None)[0] * scale
        setup = setup.moved(step)
        if float(np.abs(step).max(initial=0.0)) < 1e-9:
            break
    return replace(setup, shift=None), np.abs(misfit)


def _multilateration(points: np.ndarray, length: np.ndarray, *, free_start: bool) -> tuple[np.ndarray, float]:
    """Return the station and its dead path from (n, 3) points p and (n,) lengths l, metres.

    (l + d)² = |p − o|², so l² + 2·l·d = |p|² − 2 p·o + (|o|² − d²): linear in o, d and the last bracket.
    """
    # Centred, so that points in a plane give the station in that plane, not one near the frame's origin.
    centre = points.mean(axis=0)
    p, l = points - centre, length
    matrix = np.concatenate([2.0 * p, 2.0 * float(free_start) * l[:, None], -np.ones((len(p), 1))], axis=1)
    right = np.sum(p * p, axis=1) - l * l
    weight = np.ones(len(p))
    for _ in range(SWEEPS):
        root = np.sqrt(weight)
        solved = np.linalg.lstsq(matrix * root[:, None], right * root, rcond=1e-12)[0]
        weight = FLOOR / np.maximum(np.abs(right - matrix @ solved), FLOOR)
    return solved[:3] + centre, float(solved[3])
