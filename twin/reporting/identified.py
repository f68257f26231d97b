"""Read the JSON file of `twin identify --json`: quality of the fit, and errors that were not identifiable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from twin._common.errors import InputError
from twin._common.files import read_json
from twin._common.messages import Message, Quoted
from twin._common.records import json_form
from twin.measurement.instruments import INSTRUMENTS
from twin.model.calibration import Calibration
from twin.model.effects import Effect, unit_of
from twin.tool.forward import Kinematics

SCHEMA: Final = "twin.identification/1"
NOISE: Final[Mapping[str, str]] = MappingProxyType({"stated": Message("stated"), "repeats": Message("repeats")})
POINTS: Final = 201
"""Number of points at which `twin identify` evaluates a curve for its peak."""
DOUBTFUL: Final = 4.0
"""Reduced chi² above which residuals are more than an understated noise: twice the stated one."""
SAME: Final = 1e-6
"""Relative tolerance for equal numbers; files hold all digits, so a larger difference means another estimate."""


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True)


@final
class Points(_Model):
    """Numbers of used and of excluded rows of a table."""

    used: int
    set_aside: int


@final
class IdentifiedError(_Model):
    """One identified error: a curve with order and peak, or a single value."""

    name: str
    order: int | None = None
    peak: float | None = None
    value: float | None = None


@final
class NotIdentifiableEntry(_Model):
    """An error that was not identifiable from the data."""

    name: str
    reason: str


@final
class Misfit(_Model):
    """Quality of the fit; None without degrees of freedom, or without repeats."""

    rms_um: float
    reduced_chi2: float | None
    dof: float
    p_value: float | None
    lack_of_fit_p_value: float | None = None


@final
class Row(_Model):
    """An excluded row of the table."""

    line: int
    reason: str


@final
class StationEntry(_Model):
    """The instrument of a station; empty in files of older versions."""

    instrument: str = ""


@final
class IdentificationFile(_Model):
    """The part of the output of `twin identify --json` that a machine report uses."""

    schema_: Literal["twin.identification/1"] = Field(alias="schema")
    machine: str
    data: str
    points: Points
    uncertainty: str
    errors: tuple[IdentifiedError, ...]
    not_identifiable: tuple[NotIdentifiableEntry, ...]
    stations: dict[str, StationEntry] = {}
    misfit: Misfit
    set_aside: tuple[Row, ...]
    notices: tuple[str, ...]
    converged: bool


@final
@dataclass(frozen=True)
class Identified:
    """Result of an identification, compared with a calibration."""

    path: Path
    file: IdentificationFile
    others: tuple[str, ...]  # whose numbers differ: another calibration, or extended since

    @property
    def orders(self) -> dict[str, int]:
        """Order of every identified curve, by name."""
        return {error.name: error.order for error in self.file.errors if error.order is not None}

    @property
    def doubtful(self) -> bool:
        """Whether the residuals are several times the stated noise, without repeats that show whether the noise is the reason."""
        fit = self.file.misfit
        return fit.lack_of_fit_p_value is None and fit.reduced_chi2 is not None and fit.reduced_chi2 > DOUBTFUL

    @property
    def relative_instrument(self) -> str | None:
        """Name of the instrument that measured the tool relative to the table, if there is no other."""
        names = {station.instrument for station in self.file.stations.values()}
        relative = {instrument.name for instrument in INSTRUMENTS if instrument.specification.set_up.station_place}
        return names.pop() if len(names) == 1 and names <= relative else None

    @property
    def noise(self) -> str:
        """Source of the noise of the readings, in words."""
        return NOISE.get(self.file.uncertainty, Quoted(self.file.uncertainty))

    @property
    def rows(self) -> tuple[tuple[int, str], ...]:
        """Excluded rows of the table: line and reason."""
        return tuple((row.line, Quoted(row.reason)) for row in self.file.set_aside)

    @classmethod
    def load(cls, path: str | Path, calibration: Calibration) -> Identified:
        """Read the JSON of ``twin identify --json`` and compare it with the calibration; `InputError`: another format or machine."""
        path = Path(path)
        try:
            content = IdentificationFile.model_validate(read_json(path, "the JSON file of `twin identify`"))
        except ValidationError as error:
            first = error.errors()[0]
            entry = ".".join(str(part) for part in first["loc"]) or "the file"
            raise InputError(
                f"`{entry}` is invalid",
                expected=f"the JSON file of `twin identify`, schema: {SCHEMA}",
                file=path,
                value=first["msg"],
            ) from None
        if content.machine != calibration.machine.name:
            raise InputError(
                "the identification belongs to another machine",
                expected=calibration.machine.name,
                file=path,
                value=content.machine,
            )
        return cls(path, content, _differing(content.errors, calibration))

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        identified = self.file.model_dump(mode="json", exclude={"schema_", "machine", "errors"})
        return {"file": str(self.path), **identified, "other_numbers_than_the_calibration": list(self.others)}


def _differing(errors: tuple[IdentifiedError, ...], calibration: Calibration) -> tuple[str, ...]:
    """Return the names of errors whose numbers differ, or that only the file or only the calibration contains."""
    identified = {error.name: error.value if error.peak is None else error.peak for error in errors}
    own = {
        name: float(np.abs(curve(np.linspace(*curve.domain, POINTS))).max())
        for name, curve in calibration.curves.items()
    }
    own |= dict(calibration.squareness) | dict(calibration.location)
    return tuple(
        name
        for name in dict.fromkeys((*identified, *own))
        if (mine := own.get(name)) is None
        or (theirs := identified.get(name)) is None
        or abs(mine - theirs) > SAME * max(abs(mine), abs(theirs))
    )


# --- Measured points compared with a calibration: residuals, and an estimate of each error motion at each position


@final
@dataclass(frozen=True)
class PositionEstimates:
    """Estimates of one error motion from readings, at each position."""

    name: str  # ISO 230-1
    side: int  # direction of approach of the readings: +1 from below, −1 from above, 0 all
    position: np.ndarray  # (k,) mm or degrees
    value: np.ndarray  # (k,) µm or µrad
    half: np.ndarray  # (k,) half width of the 95 % interval

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return {"name": self.name, "unit": unit_of(self.name)} | json_form(self, rename={"half": "half_95"})


@final
@dataclass(frozen=True)
class PointComparison:
    """One table of measured points compared with a calibration."""

    source: str  # the file
    points: int  # number of points, outliers included
    far: int  # number of outliers with this calibration; the set-up was fitted to the other points
    rms_before_um: float  # RMS residual per coordinate with the nominal machine
    rms_after_um: float  # RMS residual per coordinate with the calibration
    noise_source: str  # in words; key of the JSON
    before_um: np.ndarray  # (n,) distance of each point, or of its length, from the predicted one
    after_um: np.ndarray
    stops: Mapping[str, tuple[PositionEstimates, ...]]  # estimates by error motion
    rows: tuple[tuple[int, str], ...]  # excluded rows: line and reason
    notices: tuple[str, ...]  # in the file
    left_out: tuple[str, ...]  # effects omitted because the table lacks their channel

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        result = json_form(self, rename={"source": "file", "far": "too_far_off", "rows": "set_aside"})
        return result | {
            "stops": [stop.to_dict() for stops in self.stops.values() for stop in stops],
            "set_aside": [{"line": line, "reason": reason} for line, reason in self.rows],
        }


def curve_ranges(kinematics: Kinematics) -> np.ndarray:
    """Return (axes, 2) ranges inside the domains of all curves, mm and degrees; one turn for an unlimited axis."""
    ranges, domains = np.array([axis.domain for axis in kinematics.machine.axes]), kinematics.calibration.domains()
    return np.stack([np.maximum(ranges[:, 0], domains[:, 0]), np.minimum(ranges[:, 1], domains[:, 1])], axis=1)


def is_motion(effect: Effect, axis: str, calibration: Calibration) -> bool:
    """Return whether an effect is an error motion of an axis; squareness, which is reported as an angle, is not."""
    own = effect.frame.axis == axis and effect.frame.role == "motion"
    return own and effect.name not in calibration.squareness


def sum_of_effects(effects: Sequence[Effect], state: Mapping[str, Any], component: int) -> np.ndarray:
    """Return (n,) the sum of one component over effects, µm or µrad, in n states."""
    count = len(next(iter(state.values())))
    parts = (effect.components(state).get(component, 0.0) for effect in effects)
    return np.asarray(sum(parts, np.zeros(count)), dtype=float)
