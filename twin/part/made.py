"""The features of a part as a program makes them on machines drawn from a calibration's covariance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Final, final

import numpy as np

from twin._common.resources import Progress, silent
from twin._common.units import MM, UM
from twin.compensation.programs.execute import Execution, execute_program
from twin.compensation.programs.prepared import Options
from twin.compensation.programs.words import Setup
from twin.controls.offsets import ToolTable
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc.blocks import Program
from twin.nc.dialect import Dialect
from twin.part.contact import PARALLEL, ToolContacts, contacts
from twin.part.features import PartDrawing, PlaneFeature, PointsFeature, Surface, ToolShape, Turned, across
from twin.part.zones import MOST_CENTRES, FeaturePoints
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import ToolUncertainty, errors_in, state_at

SEED: Final = 14253
TEMPERATURE: Final = "temperature of the part"
MOST_POINTS: Final = 400
"""Points of a feature that are evaluated, spread over those that the program makes."""
DRILLED: Final = 4
"""Divisor of that number for a drilled hole, which is a line."""
LARGEST_GAP: Final = np.pi
"""Angle around an axis without points, from which on a section has no centre."""


@final
@dataclass(frozen=True)
class MadeFeature:
    """Feature as a program makes it.

    Attributes:
        points: number of its points that were evaluated.
        lines: first and last line of the program that makes it.
        tool: number or name of the tool.
        program_um: largest distance of the program itself from the nominal surface.
        drilled: whether a tool's tip makes it.
    """

    points: int
    lines: tuple[int, int]
    tool: str
    program_um: float
    drilled: bool


@final
@dataclass(frozen=True, eq=False)
class Cut:
    """Contacts of one tool with a feature.

    Attributes:
        found: the contacts.
        q, sides: (n, axes) positions, mm and degrees, and directions of approach at each.
        axis: (n, 3) intended directions of the tool, in the part's frame.
        length_mm: of the tool.
    """

    found: ToolContacts
    q: np.ndarray
    sides: np.ndarray
    axis: np.ndarray
    length_mm: float

    def thinned(self, count: int) -> Cut:
        """Return some of the contacts, spread over them."""
        rows = _spread(self.found, count)
        return Cut(self.found.part(rows), self.q[rows], self.sides[rows], self.axis[rows], self.length_mm)


@final
@dataclass(frozen=True, eq=False)
class Draw:
    """Machines drawn.

    Attributes:
        errors: (r, machines) standard normal numbers, of which the calibration's covariance makes errors.
        setup: (6, machines) shift (µm) and rotation (mrad) of the part in its set-up.
        warmer_K: (machines,) temperature of the part above that of its file.
    """

    errors: np.ndarray
    setup: np.ndarray
    warmer_K: np.ndarray

    @classmethod
    def none(cls) -> Draw:
        """Return the calibrated machine alone."""
        return cls(np.zeros((0, 1)), np.zeros((6, 1)), np.zeros(1))

    def first(self, count: int) -> Draw:
        """Return the first of the machines."""
        return Draw(self.errors[:, :count], self.setup[:, :count], self.warmer_K[:count])


@final
@dataclass(frozen=True, eq=False)
class PartPlace:
    """Place of the part in the work frame: that of its zero, mm, and the axes of its frame as columns (3, 3)."""

    zero_mm: np.ndarray
    turn: np.ndarray

    @classmethod
    def at(cls, zero_mm: np.ndarray) -> PartPlace:
        """Return the place of a part that is not turned."""
        return cls(zero_mm, np.eye(3))


@final
@dataclass(frozen=True, eq=False)
class Made:
    """Points of the features under one program, on all machines, and by error of the machine as calibrated."""

    surface: Mapping[str, FeaturePoints]
    axis: Mapping[str, FeaturePoints]
    by_error: Mapping[str, Mapping[str, FeaturePoints]]  # feature to error to points, one column, of surface
    described: Mapping[str, MadeFeature]
    cuts: Mapping[str, Sequence[Cut]]


def with_tools(part: PartDrawing, setup: Setup) -> Setup:
    """Return a set-up with the lengths of a part's tools, if they have any and the set-up has none."""
    lengths = {name: tool.length for name, tool in part.tools.items() if tool.length is not None}
    if not lengths or setup.tools is not None:
        return setup
    if len(lengths) < len(part.tools):
        missing = [i for i, name in enumerate(part.tools) if name not in lengths]
        raise part.refused(
            ("tools", missing[0]), "some tools have a length and some have none", "length: of all tools, mm"
        )
    return replace(setup, tools=ToolTable(part.path, lengths))


@final
class Maker:
    """A machine with a calibration that makes a part, for one program after another."""

    def __init__(
        self, part: PartDrawing, machine: Machine, calibration: Calibration, options: Options, draw: tuple[int, int]
    ) -> None:
        self.part, self.machine, self.calibration = part, machine, calibration
        self.options = replace(options, setup=with_tools(part, options.setup))
        self._of_length: dict[float, tuple[Kinematics, ToolUncertainty]] = {}
        # Without uncertainty there is one machine, and no probability.
        machines, self._seed = draw
        self.machines = machines if self.kinematics(0.0)[1].parameters else 1

    def kinematics(self, length: float) -> tuple[Kinematics, ToolUncertainty]:
        """Return the machine with a tool of some length, and the uncertainty of its poses."""
        if length not in self._of_length:
            real = Kinematics(self.machine, self.calibration, tool_length_mm=length, conditions=self.options.conditions)
            self._of_length[length] = real, ToolUncertainty(real)
        return self._of_length[length]

    @cached_property
    def draw(self) -> Draw:
        """The machines; the first is the calibrated one, with the part exactly in its place."""
        width = len(self.kinematics(0.0)[1].parameters)
        errors = np.random.default_rng(self._seed).standard_normal((width, self.machines))
        setup = np.random.default_rng([self._seed, 1]).standard_normal((6, self.machines))
        warmer = np.random.default_rng([self._seed, 2]).standard_normal(self.machines)
        errors[:, 0] = setup[:, 0] = warmer[0] = 0.0
        return Draw(errors, setup * self.part.setup.standard[:, None], warmer * self.part.temperature.u_K)

    def run(self, read: Program, dialect: Dialect) -> Execution:
        """Execute a program."""
        used = self.options.setup, self.options.tool_length_mm
        return execute_program(
            read,
            dialect,
            self.machine,
            self.calibration,
            used,
            tcp=self.options.tcp,
            conditions=self.options.conditions,
        )

    def zero_mm(self, run: Execution) -> np.ndarray:
        """Return the place (3,) of the part's zero in the work frame, mm."""
        if not isinstance(self.part.zero, str):
            return np.array(self.part.zero)
        if self.part.zero == "table":
            return np.zeros(3)
        if len(run.zeros_mm) != 1:
            places = "; ".join(", ".join(f"{value:.3f}" for value in place) for place in run.zeros_mm[:3])
            raise self.part.refused(
                ("zero",), "the program's zero is not one place: its work offsets or the tool lengths in force move it",
                "zero: table, or its place in the work frame, mm", places,
            )  # fmt: skip
        return np.array(run.zeros_mm[0])

    def settle(self, run: Execution, zero_mm: np.ndarray) -> None:
        """Give the points to every feature that is what the program means to cut; ``run``: of the program as it is."""
        for name, feature in self.part.features.items():
            if isinstance(feature, PointsFeature) and feature.side is not None:
                points = self._beside(name, feature, run, zero_mm).tolist()
                self.part.features[name] = PointsFeature(**(feature.model_dump() | {"points": points}))

    def _beside(self, name: str, feature: PointsFeature, run: Execution, zero_mm: np.ndarray) -> np.ndarray:
        """Return (n, 6) points and normals of the surface at a side of the tool, where it does not turn within a step."""
        run = finely(run, self._chosen(name, run), STEP_MM)
        found = [np.zeros((0, 6))]
        for _, tool, rows in self._samples(name, run):
            poses = self.nominal(float(run.lengths_mm[rows[0]])).forward(run.positions[rows])
            tips, axis = poses.point_mm - zero_mm, poses.axis
            step = np.diff(tips, axis=0)
            length = np.linalg.norm(step, axis=1)
            way = step / np.maximum(length, 1e-12)[:, None]
            straight = np.flatnonzero(((way[1:] * way[:-1]).sum(axis=1) > AHEAD) & (length[1:] > 0.0)) + 1
            a, w = axis[straight], way[straight]
            up = a - (a * w).sum(axis=1, keepdims=True) * w
            up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-12)
            left = np.cross(a, w)
            left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-12)
            n = {"left": -left, "right": left, "below": up}[feature.side or "below"]
            r = tool.corner_radius
            point = tips[straight] + r * a - (r if feature.side == "below" else tool.radius) * n
            # A flat tool on a slope cuts with its edge, which is not below its tip.
            fits = (feature.side != "below") | ((a * w).sum(axis=1) ** 2 < PARALLEL**2) | (r > tool.radius - 1e-9)
            found.append(np.hstack([point, n])[fits])
        points = np.concatenate(found)
        points = points[feature.within_box(points[:, :3])]
        if len(points) < 3:
            raise self.part.refused(
                ("features", name),
                "no path whose surface is known between these lines",
                "lines of blocks that cut along a way",
            )
        return points[np.unique(np.linspace(0, len(points) - 1, MOST_POINTS).astype(int))]

    def made(self, run: Execution, *, compensated: bool, zero_mm: np.ndarray, progress: Progress = silent) -> Made:
        """Return the points that an executed program makes of every feature, and how they lie on each machine."""
        surface, described, by_error, cuts = {}, {}, {}, {}
        names, place = [*self.part.features], PartPlace.at(zero_mm)
        for i, name in enumerate(names):
            feature = self.part.features[name]
            progress(f"{name} of the part", i / len(names))
            if feature.made == "elsewhere":
                surface[name] = self.elsewhere(feature, self.machines)
                continue
            cuts[name], described[name] = self._feature(name, run, zero_mm, compensated=compensated)
            points = [self.displaced(feature, cut, place, self.draw) for cut in cuts[name]]
            surface[name] = FeaturePoints.joined(points)
            if not compensated:
                by_error[name] = self._by_error(feature, cuts[name])
        return Made(surface, self.axes(surface), by_error, described, cuts)

    def axes(self, surface: Mapping[str, FeaturePoints]) -> dict[str, FeaturePoints]:
        """Return the points of the axes of features, where these are determined."""
        turned = {name: one for name, one in self.part.features.items() if name in surface and isinstance(one, Turned)}
        found = {name: axis_points(one, surface[name]) for name, one in turned.items()}
        return {name: points for name, points in found.items() if len(points.place_mm)}

    def elsewhere(self, feature: Surface, count: int) -> FeaturePoints:
        """Return the points of a feature that is made elsewhere, exact on ``count`` machines."""
        points = feature.samples()
        normal = feature.signed_mm(points)[1]
        return FeaturePoints(points, np.array(normal), np.zeros((len(points), count)), isinstance(feature, Turned))

    def _feature(
        self, name: str, run: Execution, zero_mm: np.ndarray, *, compensated: bool
    ) -> tuple[list[Cut], MadeFeature]:
        """Return the contacts with one feature."""
        run, parts = self.touching(name, run, zero_mm, compensated=compensated)
        total = sum(len(found) for found, *_ in parts)
        cuts = []
        for found, some, axis, _ in parts:
            most = MOST_POINTS // (DRILLED if found.drilled else 1)
            kept = found.part(_spread(found, most * len(found) // total + 1))
            at = some[kept.sample]
            cuts.append(Cut(kept, run.positions[at], run.sides[at], axis[kept.sample], float(run.lengths_mm[some[0]])))
        lines = np.concatenate([run.lines[some[found.sample]] for found, some, *_ in parts])
        described = MadeFeature(
            sum(len(one.found) for one in cuts),
            (int(lines.min()), int(lines.max())),
            parts[-1][3],
            max(float(np.abs(found.off_mm).max()) for found, *_ in parts) * MM / UM,
            parts[0][0].drilled,
        )
        return cuts, described

    def touching(
        self, name: str, run: Execution, zero_mm: np.ndarray, *, compensated: bool
    ) -> tuple[Execution, list[tuple[ToolContacts, np.ndarray, np.ndarray, str]]]:
        """Return an execution with denser samples, and the contacts of each tool with a feature.

        Each: the contacts, the samples (s,) that they count among, the tool's axis (s, 3) there, and the tool's number.

        Raises `InputError`: no block makes the feature.
        """
        feature = self.part.features[name]
        parts = []
        nearest: tuple[float, int] = (np.inf, 0)
        depth = getattr(feature, "depth", None)
        chosen = self._chosen(name, run)
        within_reach = self._near(feature, (run.reached_mm if compensated else run.meant_mm) - zero_mm)
        if np.any(chosen & within_reach):
            run = part_of(run, within_reach)
        step = FREE_STEP_MM if isinstance(feature, PointsFeature) else STEP_MM
        run = finely(run, self._chosen(name, run), step if depth is None else min(step, depth / DEPTH_STEPS))
        for number, tool, rows in self._samples(name, run):
            length = float(run.lengths_mm[rows[0]])
            meant = self.kinematics(length)[0] if compensated else self.nominal(length)
            for some in np.array_split(rows, max(1, len(rows) // ROWS)):
                poses = (
                    meant.forward(run.positions[some], run.sides[some])
                    if compensated
                    else meant.forward(run.positions[some])
                )
                tips = poses.point_mm - zero_mm
                found = contacts(feature, tool, tips, poses.axis, self.part.touch_mm)
                found = found.part(_along_surface(found, tips, run.ends[some]))
                if not len(found):
                    distance = np.abs(contacts(feature, tool, tips, poses.axis, np.inf).off_mm)
                    if len(distance) and distance.min() < nearest[0]:
                        nearest = float(distance.min()), int(run.lines[some[int(distance.argmin() % len(some))]])
                    continue
                parts.append((found, some, poses.axis, number))
        if not parts:
            near = f" (tool length {' and '.join(f'{one:g}' for one in np.unique(run.lengths_mm))} mm)"
            if np.isfinite(nearest[0]):
                near += f"; the nearest block, line {nearest[1]}, stays {nearest[0]:.3f} mm away"
            raise self.part.refused(
                ("features", name), f"no block of the program makes the feature {name}{near}",
                "a surface that the program cuts, in the part's frame, and the tool that cuts it; else made: elsewhere",
            )  # fmt: skip
        # What goes around in a hole makes it, whatever tool drilled it before.
        return run, [one for one in parts if not one[0].drilled] or parts

    def nominal(self, length: float) -> Kinematics:
        """Return the machine without errors, with a tool of some length."""
        return Kinematics(self.machine, Calibration.zero(self.machine), tool_length_mm=length)

    def _samples(self, name: str, run: Execution) -> Iterator[tuple[str, ToolShape, np.ndarray]]:
        """Yield number, shape and (n,) samples of the tools that may make a feature."""
        feature, tools, chosen = self.part.features[name], self.part.tools, self._chosen(name, run)
        followed = bool(np.any(run.tools != ""))
        numbers = [str(feature.tool)] if feature.tool is not None else [*tools]
        if not followed and len(numbers) > 1:
            raise self.part.refused(
                ("features", name),
                f"which tool makes {name} is not known",
                "tool: its number; or the length of every tool",
            )
        for number in numbers:
            own = chosen & (run.tools == number) if followed else chosen
            for length in np.unique(run.lengths_mm[own]):
                yield number, tools[number], np.flatnonzero(own & (run.lengths_mm == length))

    def _chosen(self, name: str, run: Execution) -> np.ndarray:
        """Return (n,) the samples of cutting blocks in a feature's lines."""
        feature, chosen = self.part.features[name], run.cutting
        if feature.lines is not None:
            chosen = chosen & (run.lines >= feature.lines[0]) & (run.lines <= feature.lines[1])
        return np.asarray(chosen)

    def _near(self, feature: Surface, tips_mm: np.ndarray) -> np.ndarray:
        """Return (n,) the samples on whose way a tool may reach a feature."""
        way = np.linalg.norm(np.diff(tips_mm, axis=0, prepend=tips_mm[:1]), axis=1)
        reach = way + max(tool.radius + tool.reach for tool in self.part.tools.values())
        near = np.abs(feature.signed_mm(tips_mm)[0]) <= reach
        if feature.within is not None:
            low, high = np.sort(np.array(feature.within), axis=0)
            near &= ((tips_mm >= low - reach[:, None]) & (tips_mm <= high + reach[:, None])).all(axis=1)
        return np.asarray(near)

    def displaced(
        self, feature: Surface, cut: Cut, place: PartPlace, draw: Draw, *, mean: bool = True
    ) -> FeaturePoints:
        """Return the points of a cut on drawn machines, with the part at its place; ``mean``: with the errors of the calibrated one."""
        found, q, sides = cut.found, cut.q, cut.sides
        real, uncertainty = self.kinematics(cut.length_mm)
        deviation = np.zeros((len(found), draw.errors.shape[1]))
        if mean:
            poses = real.forward(q, sides)
            tip, axis = (poses.point_mm - place.zero_mm) @ place.turn, poses.axis @ place.turn
            deviation += (found.deviation_mm(feature, tip, axis, cut.axis) * MM / UM)[:, None]
        if len(draw.errors):
            components, spread = uncertainty.frame_factors(q, sides)
            root = np.einsum("ne,ner->nr", self._seen(cut, place)[:, components], spread)
            deviation += root @ draw.errors
        points = _points_of(feature, [cut])
        warmer = draw.warmer_K + (self.part.temperature.mean_K if mean else 0.0)
        return points.with_deviation(deviation + points.motion @ draw.setup + self._growth(points)[:, None] * warmer)

    def _growth(self, points: FeaturePoints) -> np.ndarray:
        """Return (n,) deviations at the drawing's temperature, µm per kelvin that the part was warmer when it was cut."""
        # mm of the part by its coefficient, µm/(m·K), are nm.
        return np.asarray(
            -1e-3 * self.part.temperature.expansion_um_m_K * (points.place_mm * points.normal).sum(axis=1)
        )

    def _seen(self, cut: Cut, place: PartPlace) -> np.ndarray:
        """Return (n, errors) deviations along the normals, µm, by components of the error frames, µm and µrad."""
        # Along the normal: the point's displacement, and the tool's rotation by its lever (µrad·mm are nm).
        normal, lever = cut.found.normal @ place.turn.T, cut.found.lever_mm @ place.turn.T
        sensitive = self.kinematics(cut.length_mm)[0].sensitivities(cut.q, cut.sides).error
        return np.asarray(np.einsum("nf,nfe->ne", np.hstack([normal, np.cross(lever, normal) * 1e-3]), sensitive))

    def _by_error(self, feature: Surface, cuts: Sequence[Cut]) -> dict[str, FeaturePoints]:
        """Return the points with what each error of the calibrated machine adds to them, one column."""
        parts: dict[str, list[np.ndarray]] = {}
        for cut in cuts:
            seen = self._seen(cut, PartPlace.at(np.zeros(3)))
            state = state_at(self.machine, cut.q, cut.sides, self.options.conditions)
            own: dict[str, np.ndarray] = {}
            for effect in self.calibration.effects:
                errors = errors_in(state, [effect], self.machine, len(cut.q))
                own[effect.name] = own.get(effect.name, 0.0) + (seen * errors).sum(axis=1) / UM
            for key, value in own.items():
                parts.setdefault(key, []).append(value)
        points = _points_of(feature, cuts)
        if self.part.temperature.mean_K:
            parts[TEMPERATURE] = [self._growth(points) * self.part.temperature.mean_K]
        return {key: points.with_deviation(np.concatenate(values)[:, None]) for key, values in parts.items()}


def _points_of(feature: Surface, cuts: Sequence[Cut]) -> FeaturePoints:
    """Return the points of a feature without deviations."""
    place, normal = (np.concatenate([getattr(cut.found, key) for cut in cuts]) for key in ("place_mm", "normal"))
    drilled = cuts[0].found.drilled
    sized = not (drilled or isinstance(feature, PlaneFeature | PointsFeature))
    return FeaturePoints(place, normal, np.zeros((len(place), 1)), sized, drilled)


ROWS: Final = 100_000
STEP_MM: Final = 1.0
"""Largest distance of two samples of the tool's way along a straight block."""
AHEAD: Final = 0.995
"""Cosine of the angle by which a way turns in a sample: 6°."""
FREE_STEP_MM: Final = 0.1
"""The same at points of a free-form surface."""
DEPTH_STEPS: Final = 100


ARRAYS: Final = tuple(one.name for one in fields(Execution) if one.name not in ("left_out", "unknown", "zeros_mm"))


def taken(run: Execution, rows: np.ndarray) -> Execution:
    """Return some samples of an execution, or some of them several times: (n,) booleans or indices."""
    return replace(run, **{name: getattr(run, name)[rows] for name in ARRAYS})


def part_of(run: Execution, rows: np.ndarray) -> Execution:
    """Return the samples ``rows`` (n,) of an execution; the way to the first after some that are left out is a gap."""
    return taken(replace(run, gaps=run.gaps | ~np.append(True, rows[:-1])), rows)


def finely(run: Execution, chosen: np.ndarray, step_mm: float) -> Execution:
    """Return an execution with more samples on the straight ways to some of them, (n,) booleans."""
    way = np.diff(run.meant_mm, axis=0, prepend=run.meant_mm[:1])
    length = np.linalg.norm(way, axis=1)
    unit = way / np.maximum(length, 1e-12)[:, None]
    # A way is straight if it does not turn within its block: samples of arcs are dense already.
    turns = (
        (np.linalg.norm(np.diff(unit, axis=0), axis=1) > STRAIGHT)
        & (run.lines[1:] == run.lines[:-1])
        & (length[:-1] > 0.0)
    )
    turns[~chosen[:-1] | run.gaps[:-1]] = False
    straight = ~(np.append(turns, False) | np.append(False, turns))
    parts = np.where(chosen & ~run.gaps & straight, np.clip(np.ceil(length / step_mm), 1, MOST_PARTS), 1).astype(int)
    of = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(of)) - np.repeat(np.cumsum(parts) - parts, parts) + 1.0) / parts[of]
    last = share >= 1.0 - 1e-12
    before = np.maximum(of - 1, 0)
    positions = run.positions[of]
    positions[~last] += (share[~last, None] - 1.0) * (run.positions[of] - run.positions[before])[~last]
    repeated = taken(run, of)
    return replace(repeated, positions=positions, ends=repeated.ends & last)


STRAIGHT: Final = 1e-5
MOST_PARTS: Final = 1000


def _along_surface(found: ToolContacts, tips: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the rows at which the tool moves on the surface, or a block ends on it: others only pass through."""
    if found.drilled or len(tips) < 2:
        return np.arange(len(found))
    way = np.gradient(tips, axis=0)
    length = np.linalg.norm(way, axis=1)
    way = way / np.maximum(length, 1e-12)[:, None]
    through = np.abs((way[found.sample] * found.normal).sum(axis=1)) > PASSING
    return np.flatnonzero(~through | ends[found.sample])


PASSING: Final = 0.2
"""Component of the tool's way along the normal of a surface, from which on it passes through: 12°."""


def _spread(found: ToolContacts, count: int) -> np.ndarray:
    """Return rows spread over those found, in the program's order; both rows of a point of a drilled hole."""
    step = 2 if found.drilled else 1
    total = len(found) // step
    if total <= count:
        return np.arange(len(found))
    chosen = np.unique(np.linspace(0, total - 1, count).round().astype(int))
    return np.asarray((chosen[:, None] * step + np.arange(step)).ravel())


def axis_points(feature: Turned, surface: FeaturePoints) -> FeaturePoints:
    """Return the points of the axis of a surface of revolution: centres of least-squares circles of its sections."""
    if surface.axis:
        return surface
    sides = np.array(across(feature.unit))
    along = feature.along_mm(surface.place_mm)
    places, values = [], []
    for rows in sections(along):
        lateral = surface.normal[rows] @ sides.T
        angle = np.sort(np.arctan2(lateral[:, 1], lateral[:, 0]))
        gap = np.max(np.diff(np.append(angle, angle[0] + 2.0 * np.pi)), initial=0.0)
        if len(rows) < 3 or gap > LARGEST_GAP:
            continue
        fit = np.linalg.lstsq(np.column_stack([lateral, np.ones(len(rows))]), surface.deviation_um[rows], rcond=None)[0]
        places += [feature.axis_point(along[rows].mean()[None])] * 2
        values.append(fit[:2])
    if not places:
        return FeaturePoints(
            np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, surface.deviation_um.shape[1])), axis=True
        )
    return FeaturePoints(np.concatenate(places), np.tile(sides, (len(values), 1)), np.concatenate(values), axis=True)


def sections(along: np.ndarray) -> list[np.ndarray]:
    """Return the points of each section across an axis: at the same place along it, or in equal parts of its length."""
    different = np.unique(along.round(3))
    if len(different) <= MOST_CENTRES:
        return [np.flatnonzero(np.abs(along - place) < 1e-3) for place in different]
    edges = np.linspace(along.min(), along.max(), MOST_CENTRES + 1)
    part = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, MOST_CENTRES - 1)
    return [np.flatnonzero(part == k) for k in np.unique(part)]
