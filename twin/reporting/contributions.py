"""Error budget: contribution of each error to the error at the tool, with its uncertainty."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.json_form import json_form
from twin.display.numbers import COVERAGE_FACTOR
from twin.kinematics.forward import Kinematics, Poses
from twin.machine.effects import split_name
from twin.machine.iso16907 import error_motion_of, iso_class
from twin.machine.unknown_errors import unknown_effects
from twin.reporting.words import named
from twin.uncertainty.at_tool import ToolUncertainty, radius_95
from twin.uncertainty.budget import BudgetRow, PartialErrors, error_budget, random_approach, volume_inside_domains

JSON_NAMES: Final = MappingProxyType(
    {
        "iso_class": "class",
        "peak_half": "peak_half_95",
        "u_rms_um": "U_rms_um",
        "u_max_um": "U_max_um",
        "u_complete": "U_complete",
    }
)


@final
@dataclass(frozen=True)
class Contribution:
    """Contribution of one error, or of all errors of a class, to the error of the tool point over the volume.

    Attributes:
        name: ISO 230-1 name, name of the effect, or class of ISO/TR 16907.
        words: name in words.
        iso_class: class of ISO/TR 16907.
        axis: the axis it belongs to; empty for a class.
        unit: ``um`` or ``urad`` of ``peak``; empty for a class.
        peak: largest absolute value over the range; NaN for a class.
        peak_half: half width of the widest 95 % interval; NaN if unknown.
        rms_um, max_um: error of the tool point from this error alone.
        u_rms_um, u_max_um: U of the tool point from its uncertainty alone, RMS and largest over the poses; NaN if unknown.
        u_complete: whether all its parameters have an uncertainty; if not, a known U is a lower bound.
        illustrative: whether it is assumed, not measured.
    """

    name: str
    words: str
    iso_class: str
    axis: str
    unit: str
    peak: float
    peak_half: float
    rms_um: float
    max_um: float
    u_rms_um: float
    u_max_um: float
    u_complete: bool
    illustrative: bool

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON; null for unknown numbers."""
        of_one_error = ("axis", "unit", "peak", "peak_half")
        return json_form(self, rename=JSON_NAMES, leave_out=() if self.unit else of_one_error)


@final
@dataclass(frozen=True)
class Budget:
    """Error budget of a machine at the tool, over the volume.

    Attributes:
        kinematics: the machine with its errors.
        positions: (n, axes) poses, mm and degrees.
        sides: (n, axes) directions of approach, +1 or −1.
        error_um: (n, 3) error of the tool point in the work frame.
        tilt_urad: (n, 2) tilt of the tool axis about the tool's x and y.
        errors: contributions of single errors, largest at the tool first.
        classes: contributions of classes, largest first.
        total: contribution of all errors together.
        without_uncertainty: names of the errors with a value but no uncertainty.
        not_identified: names of the errors left out because they could not be determined; U of total and classes includes them.
    """

    kinematics: Kinematics
    positions: np.ndarray
    sides: np.ndarray
    error_um: np.ndarray
    tilt_urad: np.ndarray
    errors: tuple[Contribution, ...]
    classes: tuple[Contribution, ...]
    total: Contribution
    without_uncertainty: tuple[str, ...]
    not_identified: tuple[str, ...]

    @property
    def worst(self) -> dict[str, float]:
        """Position of the largest error of the tool point, by axis."""
        row = self.positions[int(np.argmax(np.linalg.norm(self.error_um, axis=1)))]
        return dict(zip(self.kinematics.machine.names, row.tolist(), strict=True))

    @property
    def by_name(self) -> dict[str, Contribution]:
        """Contributions of single errors by name."""
        return {one.name: one for one in self.errors}

    def rms_without_um(self, name: str) -> float:
        """Return the RMS error over the volume with one error removed, µm.

        Args:
            name: name of that error.
        """
        others = {effect.name for effect in self.kinematics.calibration.effects} - {name}
        ((nominal, found),) = self._partial.poses([others])
        remaining = found.point_mm - nominal.point_mm
        return float(np.sqrt(np.mean(np.sum(remaining**2, axis=1)))) * 1e3

    @cached_property
    def _partial(self) -> PartialErrors:
        return PartialErrors(self.kinematics, self.positions, self.sides)

    @cached_property
    def nominal_poses(self) -> Poses:
        """Return the poses of the nominal machine."""
        return nominal_machine(self.kinematics).forward(self.positions)


def without(real: Kinematics, names: Collection[str]) -> Kinematics:
    """Return the kinematics without some of the errors."""
    return real.where(lambda name: name not in names)


def nominal_machine(real: Kinematics) -> Kinematics:
    """Return the kinematics of the nominal machine, without errors."""
    return real.where(lambda name: False)


def budget(kinematics: Kinematics) -> Budget:
    """Return the error budget over the volume, with U of every contribution.

    U of one error includes the uncertainty of its own parameters only; U of a class includes the covariance between its errors, and the
    plausible size of those that could not be determined. First
    order (JCGM 100, 5.2.2), as in `twin.uncertainty.at_tool`.

    Args:
        kinematics: machine, errors, tool, conditions.
    """
    machine, calibration = kinematics.machine, kinematics.calibration
    rows, classes = error_budget(
        machine, calibration, tool_length_mm=kinematics.tool_length_mm, conditions=kinematics.conditions
    )
    q = volume_inside_domains(calibration)
    sides = random_approach(q)
    meant, reached = nominal_machine(kinematics).forward(q), kinematics.forward(q, sides)
    share = _Shares(kinematics, q, sides)
    acts = {effect.name: error_motion_of(effect, machine) for effect in calibration.effects}
    errors = [_contribution(row, share, [row.name], acts[row.name]) for row in rows]
    uncertain = acts | {name: name for name in share.tool.unknown}
    by_class = [
        _contribution(
            row, share, [name for name, motion in uncertain.items() if iso_class(motion, machine) == row.name], ""
        )
        for row in classes[:-1]
    ]
    return Budget(
        kinematics=kinematics,
        positions=q,
        sides=sides,
        error_um=(reached.point_mm - meant.point_mm) * 1e3,
        tilt_urad=reached.tilt_urad(meant),
        errors=tuple(sorted(errors, key=lambda one: -one.rms_um)),
        classes=tuple(sorted(by_class, key=lambda one: -one.rms_um)),
        total=_contribution(classes[-1], share, list(uncertain), ""),
        without_uncertainty=share.tool.without_uncertainty,
        not_identified=share.tool.unknown,
    )


@final
class _Shares:
    """U of the tool point from the parameters of selected effects, with sensitivities computed once for all."""

    def __init__(self, kinematics: Kinematics, q: np.ndarray, sides: np.ndarray) -> None:
        self.tool = ToolUncertainty(kinematics)
        self._numbers = {
            effect.name: [parameter.name for parameter in effect.parameters]
            for effect in (*unknown_effects(kinematics.calibration), *kinematics.calibration.effects)
        }
        self._place = {name: i for i, name in enumerate(self.tool.parameters)}
        self._rates = self.tool.point_rates(q, sides)

    def u_um(self, effects: Iterable[str]) -> tuple[float, float, bool]:
        """Return RMS and largest U over the poses (NaN if unknown), and whether all parameters have an uncertainty."""
        wanted = [number for effect in effects for number in self._numbers[effect]]
        known = [number for number in wanted if number in self._place]
        if not known:
            # An effect without parameters (a table in the control) has no uncertainty.
            return (np.nan, np.nan, False) if wanted else (0.0, 0.0, True)
        rates = self._rates[:, :, [self._place[number] for number in known]]
        u = radius_95(rates @ self.tool.covariance.of(known).matrix @ rates.transpose(0, 2, 1))
        return float(np.sqrt(np.mean(u**2))), float(u.max()), len(known) == len(wanted)


def _contribution(row: BudgetRow, share: _Shares, effects: list[str], motion: str) -> Contribution:
    u_rms, u_max, complete = share.u_um(effects)
    return Contribution(
        name=row.name,
        words=named(row.name, share.tool.kinematics.machine),
        iso_class=row.iso_class,
        axis=split_name(motion)[2] if motion.startswith("E_") else "",
        unit=row.unit,
        peak=row.peak,
        peak_half=COVERAGE_FACTOR * row.peak_u,
        rms_um=row.tool_rms_um,
        max_um=row.tool_max_um,
        u_rms_um=u_rms,
        u_max_um=u_max,
        u_complete=complete,
        illustrative=row.illustrative,
    )
