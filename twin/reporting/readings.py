"""Measured points compared with a calibration: residuals, and an estimate of each error motion at each position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from twin._common.json_form import json_form
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.effects import Effect, unit_of


@final
@dataclass(frozen=True)
class PositionEstimates:
    """Estimates of one error motion from readings, at each position.

    Attributes:
        name: ISO 230-1 name.
        side: direction of approach of the readings: +1 from below, −1 from above, 0 all.
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
        """Return the content for JSON."""
        return {"name": self.name, "unit": unit_of(self.name)} | json_form(self, rename={"half": "half_95"})


@final
@dataclass(frozen=True)
class PointComparison:
    """One table of measured points compared with a calibration.

    Attributes:
        source: the file.
        points: number of points, outliers included.
        far: number of outliers with this calibration; the set-up was fitted to the other points.
        rms_before_um: RMS residual per coordinate with the nominal machine.
        rms_after_um: RMS residual per coordinate with the calibration.
        scatter: description of the measurement noise (key of the JSON).
        before_um, after_um: (n,) distance of each point, or of its length, from the predicted one.
        stops: estimates by error motion.
        rows: excluded rows: line and reason.
        notices: notices in the file.
        left_out: effects omitted because the table lacks their channel.
    """

    source: str
    points: int
    far: int
    rms_before_um: float
    rms_after_um: float
    scatter: str
    before_um: np.ndarray
    after_um: np.ndarray
    stops: Mapping[str, tuple[PositionEstimates, ...]]
    rows: tuple[tuple[int, str], ...]
    notices: tuple[str, ...]
    left_out: tuple[str, ...]

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
