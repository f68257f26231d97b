"""Error motions of a rotary axis over a turn, with the terms of ISO 230-7:2015, clause 3.

A motion is measured at the same angles in one or several turns: radially or axially in µm, as a tilt in µrad. The mean over the
turns is the *synchronous* error motion, the deviation from turn to turn the *asynchronous* one. The once-per-turn component of a
radial or tilt motion is due to the mounting of the artefact (its eccentricity or inclination), not to the axis. It is removed, with the
constant, as the least-squares circle centre of the polar plot. For an axial motion it is real: the *fundamental* error motion.
Polar deviations are small compared with the radius at which they are drawn, so the circle is linear in them (limaçon).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np
from numpy.typing import ArrayLike

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.units import DEG
from twin.measurement.evaluation.inputs import finite_array

Kind = Literal["radial", "axial", "tilt"]
UNITS: Final[dict[Kind, Literal["um", "urad"]]] = {"radial": "um", "axial": "um", "tilt": "urad"}
WIDEST_GAP_DEG: Final = 60.0
"""Largest gap between neighbouring angles of a full turn."""
HARMONICS: Final = 12


@final
@dataclass(frozen=True)
class MotionHarmonic:
    """One harmonic of the synchronous error motion: cos·cos(kθ) + sin·sin(kθ).

    Attributes:
        order: k, periods per turn.
        cos, sin: coefficients in the motion's unit.
    """

    order: int
    cos: float
    sin: float

    @property
    def amplitude(self) -> float:
        """Amplitude (half of the range) in the motion's unit."""
        return float(np.hypot(self.cos, self.sin))

    @property
    def phase_deg(self) -> float:
        """Angle of the axis at the first maximum, 0° up to 360°/order."""
        return float(np.arctan2(self.sin, self.cos) / DEG / self.order % (360.0 / self.order))


@final
@dataclass(frozen=True)
class RotaryMotion:
    """An error motion over a turn and its values. Arrays are read-only, angles ascend.

    Values are in `unit`; each is the radial width of the ring about the polar plot's centre that just contains the curve.

    Attributes:
        name: ISO 230-1 name, such as ``E_XC``; empty if none was given.
        kind: ``radial``, ``axial`` or ``tilt``.
        unit: ``um`` or ``urad``.
        angle_deg: (k,) angles of the axis within a turn.
        readings: (turns, k) as measured.
        constant: mean of the synchronous motion (the radius of the least-squares circle).
        once_per_turn: its first harmonic; for ``radial`` and ``tilt`` the centre of the least-squares circle.
        harmonics: orders 1 up to the highest requested, fitted together.
        total: (turns, k) total error motion: the readings about their centre.
        synchronous: (k,) synchronous (average) error motion: mean over the turns.
        residual: (k,) residual synchronous error motion: without the first harmonic, also for an axial motion.
        total_value: range of `total`.
        synchronous_value: range of `synchronous`.
        fundamental_value: range of the first harmonic; an error for an axial motion, otherwise due to the mounting of the artefact.
        residual_value: range of `residual`.
        asynchronous_value: the largest range over the turns at any one angle; None for a single turn.
    """

    name: str
    kind: Kind
    unit: Literal["um", "urad"]
    angle_deg: np.ndarray
    readings: np.ndarray
    constant: float
    once_per_turn: MotionHarmonic
    harmonics: tuple[MotionHarmonic, ...]
    total: np.ndarray
    synchronous: np.ndarray
    residual: np.ndarray
    total_value: float
    synchronous_value: float
    fundamental_value: float
    residual_value: float
    asynchronous_value: float | None

    def to_text(self, decimals: int = 2) -> str:
        """Return the values and harmonics as a table.

        Args:
            decimals: number of decimals.
        """
        sign = "µm" if self.unit == "um" else "µrad"
        turns, count = self.readings.shape
        lines = [f"{self.name or 'Rotary axis'}, {self.kind} error motion by ISO 230-7:2015"]
        lines += [f"{count} angles, {turns} turn{'' if turns == 1 else 's'}, values in {sign}", ""]
        fundamental = "Fundamental" if self.kind == "axial" else "Once per turn (artefact, removed)"
        for label, value in (
            ("Total error motion", self.total_value),
            ("Synchronous", self.synchronous_value),
            (fundamental, self.fundamental_value),
            ("Residual synchronous", self.residual_value),
            ("Asynchronous", self.asynchronous_value),
        ):
            lines.append(f"{label:<36}" + ("needs two turns" if value is None else f"{value:>10.{decimals}f}"))
        lines += ["", f"{'Order':>5}{'Amplitude':>12}{'Max. at [°]':>14}"]
        lines += [f"{h.order:>5}{h.amplitude:>12.{decimals}f}{h.phase_deg:>14.1f}" for h in self.harmonics]
        return "\n".join(lines) + "\n"


def error_motion(
    angle_deg: ArrayLike, readings: ArrayLike, kind: Kind, *, name: str = "", harmonics: int = HARMONICS
) -> RotaryMotion:
    """Evaluate an error motion of a rotary axis in a fixed sensitive direction from readings over whole turns.

    Args:
        angle_deg: (k,) angles of one turn, in any order, spread over all of it; 0° and 360° are the same angle.
        readings: (k,) or (turns, k): radial and axial in µm, tilt in µrad.
        kind: ``radial``, ``axial`` or ``tilt``.
        name: ISO 230-1 name, for tables and plots.
        harmonics: highest order; at most (k − 1)/2, which k angles can resolve.

    Raises:
        InputError: arrays that do not match, a missing value, an angle given twice, less than a turn, an unknown kind.
    """
    if kind not in UNITS:
        raise InputError("unknown kind of error motion", expected=", ".join(UNITS), value=kind)
    if harmonics < 1:
        raise InputError("harmonics must be positive", expected="at least 1", value=harmonics)
    angle = finite_array("angles", angle_deg, 1) % 360.0
    measured = finite_array("readings", readings, 1, 2)
    measured = measured.reshape(-1, measured.shape[-1])
    if measured.shape[1] != len(angle):
        raise InputError("readings do not match the angles", expected=f"{len(angle)} per turn", value=measured.shape[1])
    order = np.argsort(angle)
    angle, measured = angle[order], measured[:, order]
    gaps = np.diff(angle, append=angle[0] + 360.0)
    if len(angle) > 1 and gaps.min() < 1e-9:
        raise InputError(
            "an angle occurs twice in a turn",
            expected="each angle once: leave out 360°, which is 0°; enter further turns as further rows",
            value=float(angle[int(np.argmin(gaps))]),
        )
    if gaps.max() > WIDEST_GAP_DEG:
        expected = f"neighbouring angles within {WIDEST_GAP_DEG:g}°"
        raise InputError("angles do not cover a turn", expected=expected, value=float(gaps.max()))
    mean = measured.mean(axis=0)
    constant, (once,) = fit_harmonics(angle, mean, 1)
    wave = once.cos * np.cos(angle * DEG) + once.sin * np.sin(angle * DEG)
    centre = constant + (np.zeros_like(wave) if kind == "axial" else wave)
    total, synchronous, residual = measured - centre, mean - centre, mean - constant - wave
    return RotaryMotion(
        name=name,
        kind=kind,
        unit=UNITS[kind],
        angle_deg=read_only(angle),
        readings=read_only(measured),
        constant=constant,
        once_per_turn=once,
        harmonics=fit_harmonics(angle, mean, min(harmonics, (len(angle) - 1) // 2))[1],
        total=read_only(total),
        synchronous=read_only(synchronous),
        residual=read_only(residual),
        total_value=float(np.ptp(total)),
        synchronous_value=float(np.ptp(synchronous)),
        fundamental_value=2.0 * once.amplitude,
        residual_value=float(np.ptp(residual)),
        asynchronous_value=float(np.ptp(measured, axis=0).max()) if len(measured) > 1 else None,
    )


def fit_harmonics(angle: np.ndarray, values: np.ndarray, highest: int) -> tuple[float, tuple[MotionHarmonic, ...]]:
    """Fit a constant and harmonics by least squares, also to uneven angles; for even ones it is the discrete Fourier transform.

    Of a radius over the angle, the constant and the first harmonic are the radius and the centre of the least-squares circle.

    Args:
        angle: (n,) degrees.
        values: (n,) in any unit.
        highest: highest order.
    """
    phases = np.outer(angle * DEG, np.arange(1, highest + 1))
    columns = np.column_stack([np.ones(len(angle)), np.cos(phases), np.sin(phases)])
    constant, *rest = np.linalg.lstsq(columns, values, rcond=None)[0]
    found = zip(rest[:highest], rest[highest:], strict=True)
    return float(constant), tuple(MotionHarmonic(k, float(c), float(s)) for k, (c, s) in enumerate(found, start=1))
