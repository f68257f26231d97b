"""Orientation of the table, from the average lines of the rotary axes that carry it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import casadi as ca
import numpy as np

from twin._common.arrays import read_only
from twin._common.json_form import json_form
from twin._common.units import URAD
from twin.machine.calibration import Calibration
from twin.machine.chain import frame_pose
from twin.machine.effects import split_name
from twin.machine.error_vector import error_vector
from twin.numerics.spatial import fused_angles


@final
@dataclass(frozen=True)
class TableTilt:
    """Orientation of the work frame relative to its nominal one, from the average lines (``E_A0B`` … ``E_B0C``) alone.

    Attributes:
        at: rotary axes that carry the table, and their positions (degrees): zero, or the nearest position in their range.
        fused_urad: (3,) angles, independent of order, about x, y, z of the base frame: tilt of the surface about x and y, and rotation
            of the table in its surface (`twin.numerics.spatial.fused_angles`); µrad.
        u_urad: (3,) their standard uncertainties, µrad; NaN if an average line has none.
        covariance: (3, 3) µrad².
        missing: average lines without a value, taken as nominal.
    """

    at: tuple[tuple[str, float], ...]
    fused_urad: np.ndarray
    u_urad: np.ndarray
    covariance: np.ndarray
    missing: tuple[str, ...]

    @classmethod
    def of(cls, calibration: Calibration) -> TableTilt | None:
        """Return the orientation from a calibration; None if no rotary axis carries the table, or no average line has a value."""
        machine = calibration.machine
        carrying = [axis for axis in machine.axes if not axis.linear and axis.side == "work"]
        names = [
            name
            for name in machine.location_names
            if split_name(name)[0] >= 3 and split_name(name)[2] in {axis.name for axis in carrying}
        ]
        found = [name for name in names if name in calibration.location]
        if not found:
            return None
        at = {axis.name: float(np.clip(0.0, *_range(axis.lower, axis.upper))) for axis in carrying}
        q = ca.SX([at.get(axis.name, 0.0) * axis.scale for axis in machine.axes])
        lines = calibration.where(lambda name: name in found)
        e = ca.SX.sym("e", 6 * len(machine.frames))
        turned, nominal = (
            frame_pose(machine, machine.work_frame, q, error).rotation for error in (e, ca.SX(e.shape[0], 1))
        )
        angles = fused_angles(turned @ nominal.T)
        rates = ca.Function("table", [e], [angles, ca.jacobian(angles, e)])
        value, rate = rates(ca.evalf(error_vector(machine, lines.effects, q)))
        slots = [6 * _location(calibration, name) + split_name(name)[0] for name in found]
        jacobian = np.asarray(rate)[:, slots]
        known = set(found) <= set(calibration.covariance.names)
        matrix = calibration.covariance.of(found).matrix if known else np.full((len(found), len(found)), np.nan)
        covariance = jacobian @ matrix @ jacobian.T
        return cls(
            tuple(at.items()),
            read_only(np.asarray(value).ravel() / URAD),
            read_only(np.sqrt(np.diag(covariance))),
            read_only(covariance),
            tuple(name for name in names if name not in found),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        form = json_form(self, rename={"at": "at_deg"}, leave_out=["covariance"])
        return dict(form) | {"at_deg": dict(self.at)}

    def to_text(self, coverage: float) -> str:
        """Return one line, with ± ``coverage`` standard uncertainties where they are known."""
        x, y, z = (
            f"{value:.2f}" + (f" ± {coverage * u:.2f}" if np.isfinite(u) else "")
            for value, u in zip(self.fused_urad, self.u_urad, strict=True)
        )
        place = " ".join(f"{name} {value:g}" for name, value in self.at)
        text = f"table at {place}: tilted by {x} µrad about x and {y} about y, rotated by {z} about z (angles independent of order)"
        return f"{text}, without {', '.join(self.missing)}" if self.missing else text


def _range(lower: float | None, upper: float | None) -> tuple[float, float]:
    return -np.inf if lower is None else lower, np.inf if upper is None else upper


def _location(calibration: Calibration, name: str) -> int:
    axis = split_name(name)[2]
    frames = calibration.machine.frames
    return next(i for i, frame in enumerate(frames) if frame.axis == axis and frame.role == "location")
