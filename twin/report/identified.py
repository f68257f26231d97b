"""What `twin identify --json` wrote beside a calibration: how well the model fitted, and what the data could not tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from twin._common.errors import InputError
from twin._common.files import read_json
from twin.machine.calibration import Calibration

SCHEMA: Final = "twin.identification/1"
POINTS: Final = 201
"""At which `twin identify` looks for a peak."""
SAME: Final = 1e-6
"""Relative: the calibration's text carries all digits, so that other numbers are other estimates."""


class _Points(BaseModel):
    model_config = ConfigDict(frozen=True)
    used: int
    set_aside: int


class _Error(BaseModel):
    model_config = ConfigDict(frozen=True)
    name: str
    order: int | None = None
    peak: float | None = None
    value: float | None = None


class _Unidentified(BaseModel):
    model_config = ConfigDict(frozen=True)
    name: str
    reason: str


class _Misfit(BaseModel):
    model_config = ConfigDict(frozen=True)
    rms_um: float
    reduced_chi2: float | None
    dof: float
    p_value: float | None
    lack_of_fit_p_value: float | None = None


class _Row(BaseModel):
    model_config = ConfigDict(frozen=True)
    line: int
    reason: str


class _File(BaseModel):
    model_config = ConfigDict(frozen=True)
    schema_: Literal["twin.identification/1"] = Field(alias="schema")
    machine: str
    data: str
    points: _Points
    uncertainty: str
    errors: tuple[_Error, ...]
    not_identifiable: tuple[_Unidentified, ...]
    misfit: _Misfit
    set_aside: tuple[_Row, ...]
    notices: tuple[str, ...]
    converged: bool


@final
@dataclass(frozen=True)
class Identified:
    """The report of an identification, as far as a report of the machine needs it.

    Attributes:
        path: the file.
        data: what was measured, by its file.
        used, set_aside: rows of it.
        spread: whose scatter the intervals carry.
        orders: how many functions `identify` gave a curve beyond its datum, by name.
        not_identifiable: names with the reason.
        rms_um: of what was left of the readings, a coordinate.
        reduced_chi2, dof, p_value: of the fit; NaN without degrees of freedom.
        lack_p_value: of what repeats against what scatters; None without repeats.
        rows: of the table that were set aside, line and reason.
        notices: what a reader must know.
        converged: whether the estimate settled.
        others: errors to which it gives other numbers than the calibration has: it belongs to another one, or that was extended since.
    """

    path: Path
    data: str
    used: int
    set_aside: int
    spread: str
    orders: Mapping[str, int]
    not_identifiable: tuple[tuple[str, str], ...]
    rms_um: float
    reduced_chi2: float
    dof: float
    p_value: float
    lack_p_value: float | None
    rows: tuple[tuple[int, str], ...]
    notices: tuple[str, ...]
    converged: bool
    others: tuple[str, ...]

    @classmethod
    def load(cls, path: str | Path, calibration: Calibration) -> Identified:
        """Read the file.

        Args:
            path: what ``twin identify --json`` wrote.
            calibration: what it wrote beside it.

        Raises:
            InputError: it is no such file, or of another machine.
        """
        path = Path(path)
        try:
            found = _File.model_validate(read_json(path, "what `twin identify --json` wrote"))
        except ValidationError as error:
            first = error.errors()[0]
            entry = ".".join(str(part) for part in first["loc"]) or "the file"
            raise InputError(
                f"`{entry}` does not fit",
                expected=f"what `twin identify --json` wrote, schema: {SCHEMA}",
                file=path,
                value=first["msg"],
            ) from None
        if found.machine != calibration.machine.name:
            raise InputError(
                "an identification of another machine",
                expected=calibration.machine.name,
                file=path,
                value=found.machine,
            )
        return cls(
            path=path,
            data=found.data,
            used=found.points.used,
            set_aside=found.points.set_aside,
            spread=found.uncertainty,
            orders={one.name: one.order for one in found.errors if one.order is not None},
            not_identifiable=tuple((one.name, one.reason) for one in found.not_identifiable),
            rms_um=found.misfit.rms_um,
            reduced_chi2=_or_nan(found.misfit.reduced_chi2),
            dof=found.misfit.dof,
            p_value=_or_nan(found.misfit.p_value),
            lack_p_value=found.misfit.lack_of_fit_p_value,
            rows=tuple((one.line, one.reason) for one in found.set_aside),
            notices=found.notices,
            converged=found.converged,
            others=_others(found.errors, calibration),
        )

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "file": str(self.path),
            "data": self.data,
            "points": {"used": self.used, "set_aside": self.set_aside},
            "uncertainty": self.spread,
            "not_identifiable": [{"name": name, "reason": reason} for name, reason in self.not_identifiable],
            "misfit": {
                "rms_um": self.rms_um,
                "reduced_chi2": self.reduced_chi2,
                "dof": self.dof,
                "p_value": self.p_value,
                "lack_of_fit_p_value": self.lack_p_value,
            },
            "set_aside": [{"line": line, "reason": reason} for line, reason in self.rows],
            "notices": list(self.notices),
            "converged": self.converged,
            "other_numbers_than_the_calibration": list(self.others),
        }


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value


def _others(errors: tuple[_Error, ...], calibration: Calibration) -> tuple[str, ...]:
    """Names to which file and calibration give different numbers, or only one of them gives any."""
    told = {one.name: one.value if one.peak is None else one.peak for one in errors}
    own = {
        name: float(np.abs(curve(np.linspace(*curve.domain, POINTS))).max())
        for name, curve in calibration.curves.items()
    }
    own |= dict(calibration.squareness) | dict(calibration.location)
    return tuple(
        name
        for name in dict.fromkeys((*told, *own))
        if (mine := own.get(name)) is None
        or (theirs := told.get(name)) is None
        or abs(mine - theirs) > SAME * max(abs(mine), abs(theirs))
    )
