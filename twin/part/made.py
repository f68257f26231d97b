"""The features of a part as a program makes them on machines drawn from a calibration's covariance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Final, final

import numpy as np

from twin._common.resources import Progress, silent
from twin._common.units import MM, UM
from twin.compensation.programs.execute import Execution, execute_program
from twin.compensation.programs.prepared import Options
from twin.compensation.programs.words import WordSpace
from twin.controls.offsets import ToolTable
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc.blocks import Program
from twin.nc.dialect import Dialect
from twin.part.contact import ToolContacts, contacts
from twin.part.features import PartDrawing, PlaneFeature, Surface, ToolShape, Turned, across
from twin.part.zones import MOST_CENTRES, FeaturePoints
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import ToolUncertainty, errors_in, state_at

SEED: Final = 14253
MOST_POINTS: Final = 400
"""Points of a feature that are evaluated, spread over those that the program makes."""
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
class Made:
    """Points of the features under one program, on all machines, and by error of the machine as calibrated."""

    surface: Mapping[str, FeaturePoints]
    axis: Mapping[str, FeaturePoints]
    by_error: Mapping[str, Mapping[str, FeaturePoints]]  # feature to error to points, one column, of surface
    described: Mapping[str, MadeFeature]


@final
class Maker:
    """A machine with a calibration that makes a part, for one program after another."""

    def __init__(
        self, part: PartDrawing, machine: Machine, calibration: Calibration, options: Options, draw: tuple[int, int]
    ) -> None:
        self.part, self.machine, self.calibration = part, machine, calibration
        self.options = self._with_tools(options)
        self._of_length: dict[float, tuple[Kinematics, ToolUncertainty]] = {}
        # Without uncertainty there is one machine, and no probability.
        machines, self._seed = draw
        self._machines = machines if self.kinematics(0.0)[1].parameters else 1

    def _with_tools(self, options: Options) -> Options:
        lengths = {name: tool.length for name, tool in self.part.tools.items() if tool.length is not None}
        if not lengths or options.setup.tools is not None:
            return options
        if len(lengths) < len(self.part.tools):
            missing = [i for i, name in enumerate(self.part.tools) if name not in lengths]
            raise self.part.refused(
                ("tools", missing[0]), "some tools have a length and some have none", "length: of all tools, mm"
            )
        return replace(options, setup=replace(options.setup, tools=ToolTable(self.part.path, lengths)))

    def kinematics(self, length: float) -> tuple[Kinematics, ToolUncertainty]:
        """Return the machine with a tool of some length, and the uncertainty of its poses."""
        if length not in self._of_length:
            real = Kinematics(self.machine, self.calibration, tool_length_mm=length, conditions=self.options.conditions)
            self._of_length[length] = real, ToolUncertainty(real)
        return self._of_length[length]

    @cached_property
    def draws(self) -> np.ndarray:
        """(r, machines) standard normal numbers; the first machine is the calibrated one."""
        width = len(self.kinematics(0.0)[1].parameters)
        drawn = np.random.default_rng(self._seed).standard_normal((width, self._machines))
        drawn[:, 0] = 0.0
        return drawn

    @cached_property
    def placed(self) -> np.ndarray:
        """(6, machines) shift (µm) and rotation (mrad) of the part in its set-up; none of the first machine."""
        drawn = np.random.default_rng([self._seed, 1]).standard_normal((6, self._machines))
        drawn[:, 0] = 0.0
        return drawn * self.part.setup.standard[:, None]

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
        setup = self.options.setup
        if setup.offsets is not None:
            raise self.part.refused(
                ("zero",),
                "the program's zero is not one place: it selects work offsets from a table",
                "zero: table, or its place in the work frame, mm",
                self.part.zero,
            )
        space = WordSpace(self.machine, setup, float(run.lengths_mm[0]))
        words = np.zeros((1, len(self.machine.names)))
        return np.array(space.nominal.forward(space.commands(words, np.array([self.options.tcp]))).point_mm[0])

    def made(self, run: Execution, *, compensated: bool, zero_mm: np.ndarray, progress: Progress = silent) -> Made:
        """Return the points that an executed program makes of every feature, and how they lie on each machine."""
        surface, axis, described, by_error = {}, {}, {}, {}
        names = [*self.part.features]
        for i, name in enumerate(names):
            feature = self.part.features[name]
            progress(f"{name} of the part", i / len(names))
            if feature.made == "elsewhere":
                surface[name] = self._elsewhere(feature)
            else:
                surface[name], described[name], by_error[name] = self._feature(
                    name, run, zero_mm, compensated=compensated
                )
            if isinstance(feature, Turned):
                axis[name] = axis_points(feature, surface[name])
                if not len(axis[name].place_mm):
                    del axis[name]
        return Made(surface, axis, by_error, described)

    def _elsewhere(self, feature: Surface) -> FeaturePoints:
        points = feature.samples()
        normal = feature.signed_mm(points)[1]
        return FeaturePoints(
            points, np.array(normal), np.zeros((len(points), self._machines)), isinstance(feature, Turned)
        )

    def _feature(
        self, name: str, run: Execution, zero_mm: np.ndarray, *, compensated: bool
    ) -> tuple[FeaturePoints, MadeFeature, dict[str, FeaturePoints]]:
        """Return one feature's points on all machines."""
        feature = self.part.features[name]
        run, parts = self.touching(name, run, zero_mm, compensated=compensated)
        total = sum(len(found) for found, *_ in parts)
        points, by_error = [], []
        for found, some, axis, _ in parts:
            kept = found.part(_spread(found, MOST_POINTS * len(found) // total + 1))
            one, each = self._deviations(feature, kept, (some, axis, run, zero_mm), by_error=not compensated)
            points.append(one)
            by_error.append(each)
        lines = np.concatenate([run.lines[some[found.sample]] for found, some, *_ in parts])
        described = MadeFeature(
            sum(len(one.place_mm) for one in points),
            (int(lines.min()), int(lines.max())),
            parts[-1][3],
            max(float(np.abs(found.off_mm).max()) for found, *_ in parts) * MM / UM,
            parts[0][0].drilled,
        )
        joined = {key: FeaturePoints.joined([each[key] for each in by_error]) for key in by_error[0]}
        return FeaturePoints.joined(points), described, joined

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
        run = finely(run, self._chosen(name, run), STEP_MM if depth is None else min(STEP_MM, depth / DEPTH_STEPS))
        for number, tool, rows in self._samples(name, run):
            length = float(run.lengths_mm[rows[0]])
            meant = self.kinematics(length)[0] if compensated else self._nominal(length)
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
            near = (
                f"; the nearest block, line {nearest[1]}, stays {nearest[0]:.3f} mm away"
                if np.isfinite(nearest[0])
                else ""
            )
            raise self.part.refused(
                ("features", name), f"no block of the program makes the feature {name}{near}",
                "a surface that the program cuts, in the part's frame, and the tool that cuts it; else made: elsewhere",
            )  # fmt: skip
        # What goes around in a hole makes it, whatever tool drilled it before.
        return run, [one for one in parts if not one[0].drilled] or parts

    def _nominal(self, length: float) -> Kinematics:
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

    def _deviations(
        self,
        feature: Surface,
        found: ToolContacts,
        at: tuple[np.ndarray, np.ndarray, Execution, np.ndarray],
        *,
        by_error: bool,
    ) -> tuple[FeaturePoints, dict[str, FeaturePoints]]:
        """Return points with their deviations on all machines and, ``by_error``, those of each error on the calibrated one."""
        some, axis, run, zero_mm = at
        rows = some[found.sample]
        real, uncertainty = self.kinematics(float(run.lengths_mm[rows[0]]))
        q, sides = run.positions[rows], run.sides[rows]
        poses = real.forward(q, sides)
        mean = found.deviation_mm(feature, poses.point_mm - zero_mm, poses.axis, axis[found.sample]) * MM / UM
        sensitive = real.sensitivities(q, sides).error
        components, spread = uncertainty.frame_factors(q, sides)
        # Along the normal: the point's displacement, and the tool's rotation by its lever (µrad·mm are nm).
        lever = np.cross(found.lever_mm, found.normal) * 1e-3
        seen = np.einsum("nf,nfe->ne", np.hstack([found.normal, lever]), sensitive)
        root = np.einsum("ne,ner->nr", seen[:, components], spread)
        sized = not (found.drilled or isinstance(feature, PlaneFeature))
        points = FeaturePoints(found.place_mm, found.normal, mean[:, None] + root @ self.draws, sized, found.drilled)
        points = points.with_deviation(points.deviation_um + points.motion @ self.placed)
        state = state_at(self.machine, q, sides, self.options.conditions)
        each: dict[str, np.ndarray] = {}
        for effect in self.calibration.effects if by_error else ():
            own = errors_in(state, [effect], self.machine, len(q))
            each[effect.name] = each.get(effect.name, 0.0) + (seen * own).sum(axis=1) / UM
        return points, {key: points.with_deviation(value[:, None]) for key, value in each.items()}


ROWS: Final = 100_000
STEP_MM: Final = 1.0
"""Largest distance of two samples of the tool's way along a straight block."""
DEPTH_STEPS: Final = 100


ARRAYS: Final = tuple(one.name for one in fields(Execution) if one.name not in ("left_out", "unknown"))


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
