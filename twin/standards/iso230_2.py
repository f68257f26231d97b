"""Positioning of a linear or rotary axis, evaluated according to ISO 230-2:2014.

Input are the deviations at each target from n approaches in the positive direction (the standard's ↑, here ``forward``) and n in the
negative one (↓, ``backward``). A test with fewer targets or cycles than clause 4.3 requires is evaluated and marked. The measurement
uncertainty (annex A) is not included, because it depends on the instrument.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np
from numpy.typing import ArrayLike

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.messages import Message
from twin._common.units import MM
from twin.standards.iso230_1 import check_same_length, finite_array

CYCLES: Final = 5
TARGETS: Final = 5
TARGETS_PER_METRE: Final = 5
LONGEST_MM: Final = 2000.0
ROTARY_TARGETS: Final = ((90.0, 3), (180.0, 5), (360.0, 8))
"""Travel up to this many degrees → least number of targets."""

Unit = Literal["um", "urad"]
_SIGNS: Final = {"mm": "mm", "deg": "°"}


@final
@dataclass(frozen=True)
class Positioning:
    """Result of ISO 230-2:2014 for one axis. Symbols are the standard's; clause numbers are of its clause 3.

    Deviations and values derived from them are in `unit`; actual minus target (3.5). Arrays are read-only, one row for each target in
    the order given.
    """

    axis: str  # its name, for tables and plots
    unit: Unit
    target_unit: Literal["mm", "deg"]
    target: np.ndarray  # (m,) target positions, in `target_unit`
    forward: np.ndarray  # forward, backward: (m, n) deviations x_ij↑ and x_ij↓
    backward: np.ndarray
    mean_forward: np.ndarray  # mean_forward, mean_backward: (m,) mean unidirectional deviations x̄_i↑, x̄_i↓ (3.10)
    mean_backward: np.ndarray
    mean: np.ndarray  # (m,) mean bidirectional deviation x̄_i (3.11)
    B_i: np.ndarray  # (m,) reversal error x̄_i↑ − x̄_i↓, with its sign (3.12)
    B: float  # of the axis: the largest abs(B_i) (3.13)
    B_mean: float  # mean reversal error B̄, with its sign (3.14)
    s_i_forward: np.ndarray  # s_i_forward, s_i_backward: (m,) estimators, divisor n − 1 (3.15)
    s_i_backward: np.ndarray
    R_i_forward: np.ndarray  # R_i_forward, R_i_backward: (m,) unidirectional repeatability 4 s_i (3.16)
    R_i_backward: np.ndarray
    R_i: np.ndarray  # (m,) bidirectional repeatability max(2 s_i↑ + 2 s_i↓ + abs(B_i); R_i↑; R_i↓) (3.17)
    R_forward: float  # R_forward, R_backward: of the axis, the largest R_i↑, R_i↓ (3.18)
    R_backward: float
    R: float  # of the axis, the largest R_i (3.19)
    E_forward: float  # E_forward, E_backward: unidirectional systematic deviation, range of x̄_i↑, of x̄_i↓ (3.20)
    E_backward: float
    E: float  # bidirectional systematic deviation, range of both together (3.21)
    M: float  # mean bidirectional deviation, range of x̄_i (3.22)
    A_forward: float  # A_forward, A_backward: unidirectional accuracy, range of x̄_i ± 2 s_i of one direction (3.23)
    A_backward: float
    A: float  # bidirectional accuracy, range of both together (3.24)
    shortfalls: tuple[Message, ...]  # requirements of clause 4.3 that this test does not meet; empty if it meets all

    @property
    def cycles(self) -> int:
        """Number of approaches of each target from each side."""
        return self.forward.shape[1]


@final
@dataclass(frozen=True)
class UnidirectionalPositioning:
    """Values of ISO 230-2:2014 for approaches of all targets from one direction; symbols as in `Positioning`. Arrays are read-only."""

    axis: str  # axis, unit, target_unit, target: as in `Positioning`
    unit: Unit
    target_unit: Literal["mm", "deg"]
    direction: int  # +1 or −1
    target: np.ndarray
    deviations: np.ndarray  # (m, n)
    mean: np.ndarray  # mean, s_i: (m,) mean and estimator of every target
    s_i: np.ndarray
    R: float  # R, E, A: repeatability, systematic deviation and accuracy; R and A are NaN for a single cycle
    E: float
    A: float
    shortfalls: tuple[Message, ...]  # requirements of clause 4.3 that this test does not meet


def unidirectional(
    target: ArrayLike, deviations: ArrayLike, target_unit: Literal["mm", "deg"], direction: int, *, axis: str = ""
) -> UnidirectionalPositioning:
    """Evaluate the approaches of one direction, +1 or −1, according to ISO 230-2:2014.

    Target positions (m,), mm or degrees, each once; deviations (m, n), µm or µrad.
    """
    up = finite_array("deviations", deviations, 2)
    targets, _, _ = _checked(target, up, up, 1)
    mean, s, cycles = up.mean(axis=1), _estimator(up), up.shape[1]
    return UnidirectionalPositioning(
        axis=axis,
        unit="um" if target_unit == "mm" else "urad",
        target_unit=target_unit,
        direction=direction,
        target=targets,
        deviations=up,
        mean=read_only(mean),
        s_i=read_only(s),
        R=float(4.0 * s.max()),
        E=float(np.ptp(mean)),
        A=float((mean + 2.0 * s).max() - (mean - 2.0 * s).min()),
        shortfalls=(*_shortfalls(target_unit, targets, cycles), Message("approached from one direction only")),
    )


def bidirectional(
    target: ArrayLike,
    forward: ArrayLike,
    backward: ArrayLike,
    target_unit: Literal["mm", "deg"] = "mm",
    *,
    axis: str = "",
    fewest_cycles: int = 2,
) -> Positioning:
    """Evaluate a linear or rotary axis according to ISO 230-2:2014.

    Target positions (m,), each once; deviations (m, n) approached in the positive (forward) and negative direction, µm or µrad. With
    ``fewest_cycles`` 1 a single cycle is evaluated too; its s, R and A are then NaN.
    """
    target, forward, backward = _checked(target, forward, backward, fewest_cycles)
    mean_up, mean_down = forward.mean(axis=1), backward.mean(axis=1)
    s_up, s_down = _estimator(forward), _estimator(backward)
    mean, reversal = (mean_up + mean_down) / 2.0, mean_up - mean_down
    r_up, r_down = 4.0 * s_up, 4.0 * s_down
    both = np.max([2.0 * s_up + 2.0 * s_down + np.abs(reversal), r_up, r_down], axis=0)
    band_up = np.concatenate([mean_up - 2.0 * s_up, mean_up + 2.0 * s_up])
    band_down = np.concatenate([mean_down - 2.0 * s_down, mean_down + 2.0 * s_down])
    return Positioning(
        axis=axis,
        unit="um" if target_unit == "mm" else "urad",
        target_unit=target_unit,
        target=target,
        forward=forward,
        backward=backward,
        mean_forward=read_only(mean_up),
        mean_backward=read_only(mean_down),
        mean=read_only(mean),
        B_i=read_only(reversal),
        B=float(np.abs(reversal).max()),
        B_mean=float(reversal.mean()),
        s_i_forward=read_only(s_up),
        s_i_backward=read_only(s_down),
        R_i_forward=read_only(r_up),
        R_i_backward=read_only(r_down),
        R_i=read_only(both),
        R_forward=float(r_up.max()),
        R_backward=float(r_down.max()),
        R=float(both.max()),
        E_forward=float(np.ptp(mean_up)),
        E_backward=float(np.ptp(mean_down)),
        E=float(np.ptp(np.concatenate([mean_up, mean_down]))),
        M=float(np.ptp(mean)),
        A_forward=float(np.ptp(band_up)),
        A_backward=float(np.ptp(band_down)),
        A=float(np.ptp(np.concatenate([band_up, band_down]))),
        shortfalls=_shortfalls(target_unit, target, forward.shape[1]),
    )


def _estimator(deviations: np.ndarray) -> np.ndarray:
    """Return (m,) the estimators s_i of (m, n) deviations, divisor n − 1; NaN for a single cycle."""
    return deviations.std(axis=1, ddof=1) if deviations.shape[1] > 1 else np.full(len(deviations), np.nan)


def _shortfalls(target_unit: str, target: np.ndarray, cycles: int) -> tuple[Message, ...]:
    """Return the requirements of 4.3.2 (linear up to 2 m), 4.3.3 (longer) and 4.3.4 (rotary up to 360°) that are not met."""
    travel, shortfalls = float(np.ptp(target)), []
    if target_unit == "mm":
        if travel > LONGEST_MM:
            shortfalls.append(
                Message(
                    "travel of {travel:g} mm; above {longest:g} mm the standard has another test (4.3.3)",
                    travel=travel,
                    longest=LONGEST_MM,
                )
            )
        required = max(TARGETS, int(np.ceil(TARGETS_PER_METRE * travel * MM - 1e-9)))  # 5 for 1000 mm, not 6
    else:
        required = next((count for limit, count in ROTARY_TARGETS if travel <= limit), ROTARY_TARGETS[-1][1])
        if travel > ROTARY_TARGETS[-1][0]:
            shortfalls.append(
                Message("travel of {travel:g}°; the standard's test covers up to 360° (4.3.4)", travel=travel)
            )
    if len(target) < required:
        shortfalls.append(
            Message(
                "{count} targets, at least {required} required over {travel:g} {unit}",
                count=len(target),
                required=required,
                travel=travel,
                unit=_SIGNS[target_unit],
            )
        )
    if cycles < CYCLES:
        shortfalls.append(Message("{cycles} cycles, {required} required", cycles=cycles, required=CYCLES))
    return tuple(shortfalls)


def _checked(
    target: ArrayLike, forward: ArrayLike, backward: ArrayLike, fewest_cycles: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    targets = finite_array("targets", target, 1)
    up, down = finite_array("forward deviations", forward, 2), finite_array("backward deviations", backward, 2)
    check_same_length("forward deviations", up, "the targets", targets)
    if up.shape != down.shape:
        raise InputError(
            "backward deviations do not match the forward ones", expected=f"the same shape {up.shape}", value=down.shape
        )
    if len(targets) < 2 or up.shape[1] < fewest_cycles:
        expected = f"at least 2 targets and {fewest_cycles} cycles"
        raise InputError("too few targets or cycles", expected=expected, value=up.shape)
    found, times = np.unique(targets, return_counts=True)
    if len(found) < len(targets):
        raise InputError(
            "a target occurs twice",
            expected="each target once, its approaches in one row",
            value=float(found[times > 1][0]),
        )
    return targets, up, down
