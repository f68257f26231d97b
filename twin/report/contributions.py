"""How much each error makes at the tool, and how well that is known."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.json_form import json_form
from twin.display.numbers import COVERAGE_FACTOR
from twin.kinematics.forward import Kinematics, Poses
from twin.machine.effects import split_name
from twin.machine.iso16907 import acts_as, iso_class
from twin.report.words import named
from twin.uncertainty.at_tool import ToolUncertainty, radius_95
from twin.uncertainty.budget import BudgetRow, drawn_sides, error_budget, known_volume

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
    """One error, or all errors of one class, at the tool over the volume.

    Attributes:
        name: ISO 230-1 name, the effect's own, or the class of ISO/TR 16907.
        words: the same in words.
        iso_class: its class.
        axis: the axis it belongs to; empty for a class.
        unit: ``um`` or ``urad`` of ``peak``; empty for a class.
        peak: largest absolute value over its range; NaN for a class.
        peak_half: half width of its widest 95 % interval; NaN where it is not known.
        rms_um, max_um: error of the tool point from it alone.
        u_rms_um, u_max_um: U of the tool point from its uncertainty alone, RMS and largest over the poses; NaN where it is not known.
        u_complete: whether every number of it has an uncertainty; if not, and U is known, U is a lower bound.
        illustrative: whether it is drawn, not measured.
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
        """For JSON; null where a number is not known."""
        of_one_error = ("axis", "unit", "peak", "peak_half")
        return json_form(self, rename=JSON_NAMES, leave_out=() if self.unit else of_one_error)


@final
@dataclass(frozen=True)
class Budget:
    """What is wrong with a machine, at the tool over the volume.

    Attributes:
        kinematics: the machine with the errors the budget is of.
        positions: (n, axes) poses, mm and degrees.
        sides: (n, axes) the sides the axes are come to from.
        error_um: (n, 3) error of the tool point in the work frame.
        tilt_urad: (n, 2) lean of the tool axis, about x and y of the tool.
        errors: largest at the tool first.
        classes: likewise.
        total: all errors together.
        without_uncertainty: what has a value and no uncertainty.
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

    @property
    def worst(self) -> dict[str, float]:
        """Where the tool point is off most, by axis."""
        row = self.positions[int(np.argmax(np.linalg.norm(self.error_um, axis=1)))]
        return dict(zip(self.kinematics.machine.names, row.tolist(), strict=True))

    @property
    def by_name(self) -> dict[str, Contribution]:
        """Errors by their names."""
        return {one.name: one for one in self.errors}

    def rms_without_um(self, name: str) -> float:
        """RMS over the volume, were one of the errors not there.

        Args:
            name: of that error.
        """
        only = without(self.kinematics, {name})
        left = only.forward(self.positions, self.sides).point_mm - self.drawn().point_mm
        return float(np.sqrt(np.mean(np.sum(left**2, axis=1)))) * 1e3

    def drawn(self) -> Poses:
        """Poses of the machine as drawn."""
        return as_drawn(self.kinematics).forward(self.positions)


def without(real: Kinematics, names: Collection[str]) -> Kinematics:
    """The same machine, tool and conditions without some of the errors."""
    errors = real.calibration.where(lambda name: name not in names)
    return Kinematics(real.machine, errors, tool_length_mm=real.tool_length_mm, conditions=real.conditions)


def as_drawn(real: Kinematics) -> Kinematics:
    """The same machine and tool without any error."""
    none = real.calibration.where(lambda name: False)
    return Kinematics(real.machine, none, tool_length_mm=real.tool_length_mm)


def budget(kinematics: Kinematics) -> Budget:
    """What each error makes at the tool over the volume, and U of it.

    U of one error takes the numbers of that error as uncertain and all others as known; the covariance of numbers of one class with
    one another is in U of that class. First order (JCGM 100, 5.2.2), as `twin.uncertainty.at_tool`.

    Args:
        kinematics: machine, errors, tool, conditions.
    """
    machine, calibration = kinematics.machine, kinematics.calibration
    rows, classes = error_budget(
        machine, calibration, tool_length_mm=kinematics.tool_length_mm, conditions=kinematics.conditions
    )
    q = known_volume(calibration)
    sides = drawn_sides(q)
    meant, reached = as_drawn(kinematics).forward(q), kinematics.forward(q, sides)
    share = _Shares(kinematics, q, sides)
    acts = {effect.name: acts_as(effect, machine) for effect in calibration.effects}
    errors = [_contribution(row, share, [row.name], acts[row.name]) for row in rows]
    by_class = [
        _contribution(row, share, [name for name, motion in acts.items() if iso_class(motion, machine) == row.name], "")
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
        total=_contribution(classes[-1], share, list(acts), ""),
        without_uncertainty=share.tool.without_uncertainty,
    )


@final
class _Shares:
    """U of the tool point from the numbers of some effects alone, worked out once for all of them."""

    def __init__(self, kinematics: Kinematics, q: np.ndarray, sides: np.ndarray) -> None:
        self.tool = ToolUncertainty(kinematics)
        self._covariance = kinematics.calibration.covariance
        self._numbers = {
            effect.name: [parameter.name for parameter in effect.parameters]
            for effect in kinematics.calibration.effects
        }
        self._place = {name: i for i, name in enumerate(self.tool.parameters)}
        self._rates = np.zeros((len(q), 3, len(self.tool.parameters)))
        if self._place:
            by_error = kinematics.sensitivities(q, sides).error[:, :3]
            for component, columns, shape in self.tool.rates(q, sides):
                # Metres a metre, and metres a radian: µm a µm and a µrad.
                self._rates[:, :, columns] += by_error[:, :, component, None] * shape[:, None, :]

    def u_um(self, effects: Iterable[str]) -> tuple[float, float, bool]:
        """RMS and largest U over the poses, NaN where nothing is known of it, and whether all of it is known."""
        wanted = [number for effect in effects for number in self._numbers[effect]]
        known = [number for number in wanted if number in self._place]
        if not known:
            # What has no numbers of its own (a control's table) is as it is.
            return (np.nan, np.nan, False) if wanted else (0.0, 0.0, True)
        rates = self._rates[:, :, [self._place[number] for number in known]]
        u = radius_95(rates @ self._covariance.of(known).matrix @ rates.transpose(0, 2, 1))
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
