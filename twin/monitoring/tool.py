"""The effect of a change of the calibration at the tool, over the volume, before and after aligning the workpiece.

The position of the work frame on the machine is found by touching off before every part. A common shift and rotation (six numbers,
fitted to the change over all poses by least squares) therefore has no effect on parts. It also absorbs what no measurement of the tool
against the work can identify, so that two calibrations that differ only by convention have the same effect.

The change expected from the uncertainties alone is simulated: the numbers of both calibrations are drawn from their covariances,
independently, and propagated by the first derivatives of the tool point (JCGM 101:2008; for errors of this size the kinematic chain is
practically linear).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, final

import numpy as np

from twin._common.distributions import decide_interval
from twin._common.resources import Progress, silent
from twin.display.numbers import COVERAGE
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.model.effects import Frame
from twin.numerics.spatial import rigid_rates
from twin.tool.forward import Kinematics, Poses
from twin.tool.inverse import Inverse, Status
from twin.tool.uncertainty import ToolUncertainty, inside_domains, radius_95, random_approach, state_at, volume

POSES: Final = 400
ActingError = tuple[Frame, Callable[[Mapping[str, Any]], Mapping[int, Any]]]
"""Error frame in which a change acts, and its components as a function of the state, as in `twin.model.effects.Effect`."""
DRAWS: Final = 8000
DRAWS_A_STEP: Final = 500
"""Draws held in memory at once: 500 draws of 400 points are 5 MB."""
SEED: Final = 16907


@final
@dataclass(frozen=True)
class ToolDisplacement:
    """The displacement of the tool point over the volume."""

    rms_um: float  # this and the maximum: over the poses
    max_um: float
    where: Mapping[str, float]  # axis positions of the maximum
    u_max_um: float  # U there (`twin.tool.uncertainty.DEFINITION`); NaN if unknown.
    limit_um: float  # of the RMS for an unchanged machine, at the false alarm rate of this test; NaN if unknown
    p_value: float  # of the RMS for an unchanged machine; NaN if unknown


@final
@dataclass(frozen=True)
class DisplacementSize:
    """RMS and maximum of the displacement of the tool point over the poses."""

    rms_um: float
    max_um: float

    @classmethod
    def of(cls, displacement: np.ndarray) -> DisplacementSize:
        """Return RMS and maximum of (n, 3) displacements, µm."""
        distance = np.linalg.norm(displacement, axis=1)
        return cls(float(np.sqrt(np.mean(distance**2))), float(distance.max()))


@final
@dataclass(frozen=True)
class Remaining:
    """The error that remains if the older calibration compensates the machine described by the newer one."""

    rms_um: float  # deviation of the tool point from its nominal position, after aligning the workpiece
    max_um: float
    where: Mapping[str, float]
    as_it_is: DisplacementSize  # the same before aligning
    u_max_um: float  # U at ``where``; NaN if unknown
    upper_95_um: float  # upper 95 % limit of the largest deviation over all poses; NaN if unknown
    lower_95_um: float  # lower 95 % limit of the largest deviation over all poses; NaN if unknown
    poses: int
    out_of_reach: int  # poses not included, because their compensation leaves a travel range or a curve's domain

    def enough(self, tolerance_um: float) -> bool | None:
        """Return whether the older calibration is still good enough (ISO 14253-1); None if undecided within the uncertainty."""
        return {"pass": True, "fail": False}.get(decide_interval(self.lower_95_um, self.upper_95_um, tolerance_um))


@final
@dataclass(frozen=True)
class ToolChange:
    """The change at the tool."""

    tool_length_mm: float
    poses: int
    everything: ToolDisplacement  # all errors, including those that only one contains, before aligning
    everything_aligned: ToolDisplacement  # the same after aligning the workpiece
    judged: ToolDisplacement | None  # the errors that could be tested, after aligning; None if there are none
    by_class: Mapping[str, ToolDisplacement]  # the tested errors by class of ISO/TR 16907, after aligning
    by_cause: Mapping[str, ToolDisplacement]  # each of `JudgedErrors.causes` by itself, after aligning, without U
    by_error: Mapping[str, DisplacementSize]  # each tested error's change by itself, after aligning
    left: Remaining  # the error that remains with the older calibration


@final
class Alignment:
    """A shift and rotation of the work frame, fitted to displacements of the (n, 3) tool points in it by least squares."""

    def __init__(self, point_mm: np.ndarray) -> None:
        rates = rigid_rates((point_mm - point_mm.mean(axis=0)) / max(float(np.abs(point_mm).max(initial=0.0)), 1.0))
        left, size, _ = np.linalg.svd(rates.reshape(-1, 6), full_matrices=False)
        self._basis = left[:, size > 1e-9 * size[0]]

    def removed(self, displacement: np.ndarray) -> np.ndarray:
        """Return the (n, 3, …) displacements without the fitted shift and rotation."""
        flat = displacement.reshape(len(self._basis), -1)
        return np.asarray((flat - self._basis @ (self._basis.T @ flat)).reshape(displacement.shape))


@final
@dataclass(frozen=True)
class _CommonPoses:
    """Two calibrations evaluated at the same poses."""

    first: Calibration
    second: Calibration
    tool_length_mm: float | None
    conditions: Conditions
    q: np.ndarray
    sides: np.ndarray
    meant: Poses
    alignment: Alignment

    def kinematics(self, calibration: Calibration) -> Kinematics:
        return Kinematics(
            self.first.machine, calibration, tool_length_mm=self.tool_length_mm, conditions=self.conditions
        )

    def displacement_um(self, keep: Callable[[str], bool] = lambda name: True) -> np.ndarray:
        """Return the (n, 3) displacement, second less first, of the errors selected by ``keep``."""
        points = [
            self.kinematics(side.where(keep)).forward(self.q, self.sides).point_mm for side in (self.first, self.second)
        ]
        return np.asarray((points[1] - points[0]) * 1e3)

    @cached_property
    def state(self) -> dict[str, Any]:
        """The state of the machine that effects depend on."""
        return state_at(self.first.machine, self.q, self.sides, self.conditions)

    @cached_property
    def rates(self) -> np.ndarray:
        """The (n, 3, 6·frames) derivatives of the tool point by the error frames, m per m and rad, equal to µm per µm and µrad."""
        return self.kinematics(self.first).sensitivities(self.q, self.sides).error[:, :3]

    def displacement_of(self, frame: Frame, components: Mapping[int, Any]) -> np.ndarray:
        """Return the (n, 3) displacement of the tool point in µm due to components of one error frame, to first order."""
        frames = [(one.axis, one.role) for one in self.first.machine.frames]
        start = 6 * frames.index((frame.axis, frame.role))
        found = np.zeros((len(self.q), 3))
        for component, value in components.items():
            found += self.rates[:, :, start + component] * np.broadcast_to(value, len(self.q))[:, None]
        return found

    def displacement_by_error(self) -> dict[str, np.ndarray]:
        """Return the (n, 3) displacement of the tool point in µm due to the change of each error, by name, to first order."""
        displacement_by_error: dict[str, np.ndarray] = {}
        for sign, side in ((-1.0, self.first), (1.0, self.second)):
            for effect in side.effects:
                own = sign * self.displacement_of(effect.frame, effect.components(self.state))
                displacement_by_error[effect.name] = displacement_by_error.get(effect.name, 0.0) + own
        return displacement_by_error

    def place(self, row: int) -> dict[str, float]:
        return dict(zip(self.first.machine.names, self.q[row].tolist(), strict=True))


@final
@dataclass(frozen=True)
class JudgedErrors:
    """The errors whose change can be tested."""

    classes: Mapping[str, str]  # class of ISO/TR 16907 by name of the error
    drawn: Collection[str]  # names of those whose numbers differ between the two
    share: float  # probability of a false alarm, for all rows together
    causes: Mapping[str, ActingError]  # changes to be evaluated each by itself, by name of the error
    whole_model: bool  # whether the two calibrations have all their effects; if not, U of everything is unknown


def at_tool(
    first: Calibration,
    second: Calibration,
    known: JudgedErrors,
    *,
    tool_length_mm: float | None = None,
    conditions: Conditions | None = None,
    poses: int = POSES,
    progress: Progress = silent,
) -> ToolChange:
    """Return the change at the tool over the part of the volume in which all curves of both calibrations are defined.

    No effect may need a channel that the conditions lack. Raises `InputError` if no pose is within the domain of all curves.
    """
    machine = first.machine
    q = inside_domains(volume(machine, poses), first, second)
    at = Conditions() if conditions is None else conditions
    meant = Kinematics(machine, Calibration.zero(machine), tool_length_mm=tool_length_mm).forward(q)
    scene = _CommonPoses(first, second, tool_length_mm, at, q, random_approach(q), meant, Alignment(meant.point_mm))
    progress("at the tool", 0.1)
    whole = scene.displacement_um()
    judged, drawn = known.classes, known.drawn
    classes = [name for name in dict.fromkeys(judged.values()) if any(judged[e] == name for e in drawn)]
    chance = {} if not drawn else _simulate_unchanged(scene, judged, drawn, classes, progress)
    complete = known.whole_model and all(effect.name in judged for side in (first, second) for effect in side.effects)
    whole_chance = chance if complete else {}
    displacement_by_error, level = scene.displacement_by_error(), known.share / (1 + len(classes))
    removed = scene.alignment.removed
    by_class = {
        name: np.sum([displacement_by_error[e] for e in judged if judged[e] == name], axis=0) for name in classes
    }
    by_cause = {name: scene.displacement_of(frame, parts(scene.state)) for name, (frame, parts) in known.causes.items()}
    aligned = removed(whole)
    of_judged = aligned if complete else removed(scene.displacement_um(lambda name: name in judged))
    return ToolChange(
        tool_length_mm=scene.kinematics(first).tool_length_mm,
        poses=len(q),
        everything=_tool_displacement(scene, whole, whole_chance.get("raw", _UNKNOWN), level),
        everything_aligned=_tool_displacement(scene, aligned, whole_chance.get("all", _UNKNOWN), level),
        judged=_tool_displacement(scene, of_judged, chance["all"], level) if drawn else None,
        by_class={
            name: _tool_displacement(scene, removed(d), chance.get(name, _UNKNOWN), level)
            for name, d in by_class.items()
        },
        by_cause={name: _tool_displacement(scene, removed(d), _UNKNOWN, level) for name, d in by_cause.items()},
        by_error={name: DisplacementSize.of(removed(displacement_by_error[name])) for name in drawn},
        left=_remaining(scene, whole_chance.get("all", _UNKNOWN)),
    )


@final
@dataclass(frozen=True)
class _Simulated:
    """The simulated distribution of a displacement for an unchanged machine."""

    rms_um: np.ndarray  # (draws,) over the poses; empty if unknown
    u_um: np.ndarray  # (n,) U at every pose; empty if unknown
    factor: float = float("nan")  # multiple of U that covers all poses at once in 95 % of the draws; NaN if unknown


_UNKNOWN: Final = _Simulated(np.zeros(0), np.zeros(0))


def _simulate_unchanged(
    scene: _CommonPoses, judged: Mapping[str, str], drawn: Collection[str], classes: list[str], progress: Progress
) -> dict[str, _Simulated]:
    owner = {
        number.name: effect.name
        for side in (scene.first, scene.second)
        for effect in side.effects
        for number in effect.parameters
    }
    tools = []
    for side in (scene.first, scene.second):
        kept = side.where(lambda name: name in judged)
        own = kept.covariance.where(lambda name: owner[name] in drawn)
        tools.append(ToolUncertainty(scene.kinematics(replace(kept, joint=own)), "identified"))
    rates = [tool.point_rates(scene.q, scene.sides).reshape(3 * len(scene.q), -1) for tool in tools]
    groups: dict[str, list[np.ndarray]] = {"all": [np.arange(len(tool.parameters)) for tool in tools]}
    for name in classes:
        groups[name] = [
            np.array([i for i, number in enumerate(tool.parameters) if judged[owner[number]] == name], dtype=int)
            for tool in tools
        ]
    count = len(scene.q)
    rms: dict[str, list[np.ndarray]] = {name: [] for name in ("raw", *groups)}
    squares = {name: np.zeros((count, 3, 3)) for name in rms}
    distance = np.empty((count, DRAWS), dtype=np.float32)
    rng = np.random.default_rng(SEED)
    for start in range(0, DRAWS, DRAWS_A_STEP):
        off = [tool.draw(rng, DRAWS_A_STEP) for tool in tools]
        for name, rows in groups.items():
            moved = sum(
                rate[:, own] @ one[own] for rate, one, own in zip(rates, off, rows, strict=True)
            )  # independent draws, so the sign is arbitrary
            shaped = np.asarray(moved).reshape(count, 3, DRAWS_A_STEP)
            found = {name: scene.alignment.removed(shaped)}
            if name == "all":
                found["raw"] = shaped
                distance[:, start : start + DRAWS_A_STEP] = np.linalg.norm(found[name], axis=1)
            for which, points in found.items():
                rms[which].append(np.sqrt(np.einsum("nik,nik->k", points, points) / count))
                squares[which] += points @ points.transpose(0, 2, 1)
        progress("at the tool", 0.1 + 0.8 * (start + DRAWS_A_STEP) / DRAWS)
    u_um = {name: radius_95(squares[name] / DRAWS) for name in rms}
    moved_at_all = u_um["all"] > 1e-9 * u_um["all"].max()
    factor = float(np.quantile((distance[moved_at_all] / u_um["all"][moved_at_all, None]).max(axis=0), COVERAGE))
    return {
        name: _Simulated(np.concatenate(rms[name]), u_um[name], factor if name == "all" else np.nan) for name in rms
    }


def _unknown_u(scene: _CommonPoses) -> np.ndarray:
    """Return (n,) U of the aligned tool point from the errors of the newer calibration that could not be determined."""
    tool = ToolUncertainty(scene.kinematics(scene.second), "unknown")
    if not tool.parameters:
        return np.zeros(len(scene.q))
    aligned = scene.alignment.removed(tool.point_rates(scene.q, scene.sides))
    return radius_95(aligned @ tool.covariance.matrix @ aligned.transpose(0, 2, 1))


def _tool_displacement(
    scene: _CommonPoses, displacement: np.ndarray, chance: _Simulated, share: float
) -> ToolDisplacement:
    distance = np.linalg.norm(displacement, axis=1)
    row = int(np.argmax(distance))
    rms = float(np.sqrt(np.mean(distance**2)))
    known = len(chance.rms_um) > 0
    return ToolDisplacement(
        rms,
        float(distance[row]),
        scene.place(row),
        float(chance.u_um[row]) if known else np.nan,
        float(np.quantile(chance.rms_um, 1.0 - share)) if known else np.nan,
        float((1 + np.count_nonzero(chance.rms_um >= rms)) / (1 + DRAWS)) if known else np.nan,
    )


def _remaining(scene: _CommonPoses, chance: _Simulated) -> Remaining:
    """Return the error of commands compensated with the older calibration on the machine described by the newer."""
    machine = scene.first.machine
    older, newer = (scene.kinematics(side) for side in (scene.first, scene.second))
    keep = np.ones(len(scene.q), dtype=bool)
    if len(machine.linear) == 3 and len(machine.rotary) <= 2:
        found = Inverse(older).solve(scene.meant, scene.q, approach=scene.sides)
        keep = ~found.where(Status.OUT_OF_RANGE) & ~newer.outside_domain(found.positions).any(axis=1)
        commands = found.positions[keep]
        reached = newer.forward(commands, scene.sides[keep]).point_mm
        off = (reached - scene.meant.point_mm[keep]) * 1e3
    else:
        # Without an inverse, to first order: the remaining error is the change.
        off = scene.displacement_um()
    if not np.any(keep):
        return Remaining(np.nan, np.nan, {}, DisplacementSize(np.nan, np.nan), np.nan, np.nan, np.nan, 0, len(scene.q))
    aligned = np.linalg.norm(Alignment(scene.meant.point_mm[keep]).removed(off), axis=1)
    row = int(np.argmax(aligned))
    known = len(chance.u_um) > 0
    # Errors of the machine that were not identified are independent of those that changed: the radii add in squares, or less.
    u = np.hypot(chance.u_um, _unknown_u(scene))[keep] if known else np.full(len(aligned), np.nan)
    return Remaining(
        rms_um=float(np.sqrt(np.mean(aligned**2))),
        max_um=float(aligned[row]),
        where=scene.place(int(np.flatnonzero(keep)[row])),
        as_it_is=DisplacementSize.of(off),
        u_max_um=float(u[row]),
        upper_95_um=float(np.max(aligned + chance.factor * u)),
        lower_95_um=float(np.max(aligned - chance.factor * u)),
        poses=int(np.count_nonzero(keep)),
        out_of_reach=int(np.count_nonzero(~keep)),
    )
