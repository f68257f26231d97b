"""Six error motions of a linear axis at every position, and its curves, from the readings of a multi-axis interferometer.

They are relative to the reference position, as the counters are: constants and slopes of straightness depend on the layout's pose.
The same holds in a calibration (`twin.identification.network`), whose curves have no constant and whose straightness has no slope.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.distributions import chi2_sf
from twin._common.errors import InputError
from twin._common.messages import Message
from twin._common.provenance import warning_texts, warnings_to_json
from twin._common.records import json_form
from twin._common.units import UM, URAD, count_with_noun
from twin.identification.axis_layout import AxisLayout, BeamReadings
from twin.identification.network import Unknowns, spaces_for
from twin.machine.machine import Machine
from twin.measurement.columns import grouped_notes
from twin.measurement.instruments.multi_axis import Displacement, measure, rotation_and_jacobian
from twin.model.calibration import Calibration
from twin.model.calibration_file import MeasuredWith, MisfitEntry
from twin.model.unknown_errors import NO_REFERENCE, not_measured
from twin.numerics.curves import POWER, CurveSpace
from twin.numerics.spatial import cross_matrix, rotation_exp

Spread = Literal["stated", "repeats"]
MOST: Final = 13
"""Largest number of functions of a curve, as in `identify`."""
FEWEST: Final = 4
"""Least number of positions: one may be held out, and a straightness still has one order."""
IMPROVEMENT: Final = 1e-6
"""Relative reduction of the held-out error for which a larger model is taken."""
SIGNIFICANCE: Final = 1e-3
"""Significance level below which a misfit is reported."""
NAMES: Final = "XYZABC"
MOST_STATES: Final = 1500
"""Largest number of positions, each side counted: their joint covariance has 6 times as many rows and columns (0.6 GB)."""
MOST_ROWS: Final = 30_000
"""Largest number of rows."""
SCALE: Final = np.array([UM, UM, UM, URAD, URAD, URAD])


@final
@dataclass(frozen=True)
class Motions:
    """Error motions at g states (a position and its side of approach), µm and µrad, in the axis's error frame.

    Attributes:
        position_mm: (g,) commanded.
        approach: (g,) +1, −1, 0 unknown.
        count: (g,) number of rows of which each is the mean.
        values: (g, 6) E_X… to E_C…, minus those at the reference position.
        covariance: (6g, 6g) joint, state after state.
        u_installation: (g, 6) the part of the standard uncertainty due to the installation, which repeats do not reduce.
        repeatability: (6,) standard deviation of one row about the mean of its state; NaN without repeats.
        spread: noise on which the covariance is based.
        displacement: the carriage's motions row by row, and the estimated installation.
        simulated: whether the readings were simulated.
    """

    axis: str
    position_mm: np.ndarray
    approach: np.ndarray
    count: np.ndarray
    values: np.ndarray
    covariance: np.ndarray
    u_installation: np.ndarray
    repeatability: np.ndarray
    chi2: float
    dof: int
    spread: Spread
    displacement: Displacement
    instrument: str
    mirrors: int
    simulated: bool = False

    def __len__(self) -> int:
        return len(self.position_mm)

    @property
    def u(self) -> np.ndarray:
        """Standard uncertainties, (g, 6), µm and µrad."""
        return np.sqrt(np.diag(self.covariance)).reshape(-1, 6)

    @property
    def p_value(self) -> float:
        """Probability of a misfit at least as large if layout, noise and installation are as stated."""
        return float(chi2_sf(self.chi2, self.dof))


def error_motions(layout: AxisLayout, readings: BeamReadings, *, spread: Spread = "stated") -> Motions:
    """Estimate six error motions at every measured position.

    ``spread``: the readings' stated noise, or the standard deviation of repeats of the same state; both include the installation.

    Raises `InputError`: beams that do not determine six motions; too few or too many readings; no convergence.
    """
    keys = np.stack([np.round(readings.position_mm, 4), readings.approach], axis=1)
    state, group = np.unique(keys, axis=0, return_inverse=True)
    if len(state) > MOST_STATES or len(readings) > MOST_ROWS:
        raise InputError(
            "too many readings for a joint covariance",
            expected=f"at most {MOST_STATES} positions, each side of approach counted, and {MOST_ROWS} rows",
            file=readings.source,
            value=f"{len(state)} positions, {len(readings)} rows",
        )
    repeats = len(readings) - len(state)
    if spread == "repeats" and repeats <= 6:
        raise InputError(
            "too few repeats to estimate the noise of six motions",
            expected="at least seven more rows than states (positions, each side of approach counted)",
            file=readings.source,
            value=f"{len(readings)} rows of {len(state)} states",
        )
    displacement = _displacement(layout, readings)
    values, by_pose = _error_frames(layout, readings, displacement)
    group = group.reshape(-1)
    count = np.bincount(group)
    mean_weights = (np.arange(len(state))[:, None] == group) / count[:, None]
    mean = mean_weights @ values
    deviations = values - mean[group]
    pooled = deviations.T @ deviations / repeats if repeats else np.full((6, 6), np.nan)
    own = by_pose @ displacement.noise_covariance @ by_pose.transpose(0, 2, 1)
    each = pooled / count[:, None, None] if spread == "repeats" else np.einsum("gn,nij->gij", mean_weights**2, own)
    flat = np.einsum("gn,nip->gip", mean_weights, by_pose @ displacement.by_installation).reshape(6 * len(state), -1)
    joint = flat @ displacement.installation_covariance @ flat.T
    common = np.sqrt(np.diag(joint)).reshape(-1, 6)
    for g in range(len(state)):
        joint[6 * g : 6 * g + 6, 6 * g : 6 * g + 6] += each[g]
    return Motions(
        axis=layout.axis.name,
        position_mm=read_only(np.array(state[:, 0])),
        approach=read_only(np.array(state[:, 1])),
        count=read_only(count),
        values=read_only(mean),
        covariance=read_only((joint + joint.T) / 2.0),
        u_installation=read_only(common),
        repeatability=read_only(np.sqrt(np.diag(pooled))),
        chi2=_chi2(layout, displacement),
        dof=int(np.count_nonzero(np.isfinite(displacement.residual))) - 6 * len(readings),
        spread=spread,
        displacement=displacement,
        instrument=layout.name,
        mirrors=len(layout.beams.mirrors),
        simulated=readings.simulated,
    )


def _displacement(layout: AxisLayout, readings: BeamReadings) -> Displacement:
    """Estimate the carriage's poses row by row, starting at the nominal travel.

    Raises `InputError`: beams that do not determine six motions; no convergence.
    """
    start = np.concatenate([layout.travel(readings.position_mm), np.zeros((len(readings), 3))], axis=1)
    displacement = measure(
        layout.beams, readings.paths(layout), noise=layout.noise, installation_u=layout.installation_u, poses=start
    )
    if not displacement.converged:
        raise InputError(
            "no pose of the carriage agrees with the readings",
            expected="changes of path of this layout, in mm",
            file=readings.source,
            value=f"residuals up to {np.nanmax(np.abs(displacement.residual)) * 1e3:.3g} mm",
        )
    return displacement


def _error_frames(layout: AxisLayout, readings: BeamReadings, found: Displacement) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, 6) the error motions row by row, µm and µrad, and (n, 6, 6) their derivatives with respect to the poses."""
    # With M₀ the pose at the reference and P the translation to the carriage's point: E = T⁻¹ · M₀ P D P⁻¹, E = 1 at the reference.
    place = np.asarray(rotation_exp(found.poses[:, 3:])) @ layout.place
    _, left_jacobian = rotation_and_jacobian(found.poses[:, 3:])
    values = np.array(found.poses)
    values[:, :3] -= layout.travel(readings.position_mm)
    values[:, :3] += layout.place - place
    by_pose = np.tile(np.eye(6), (len(readings), 1, 1))
    by_pose[:, :3, 3:] = cross_matrix(place) @ left_jacobian
    return values / SCALE, by_pose / SCALE[:, None]


def _chi2(layout: AxisLayout, found: Displacement) -> float:
    """Return the whitened sum of squares of readings and installation."""
    known = layout.installation_u > 0.0
    misfit = float(np.nansum((found.residual / layout.noise) ** 2))
    return misfit + float(np.sum((found.installation[known] / layout.installation_u[known]) ** 2))


@final
@dataclass(frozen=True)
class AxisCurves:
    """Six curves of one linear axis.

    Attributes:
        calibration: the curves, with their joint covariance.
        orders: name → number of functions of its basis; without curves that do not improve the prediction.
        held_out: name → RMS prediction error at positions held out, µm or µrad.
        reversal: name → reversal value (mean of positive minus negative approach) and standard uncertainty, µm or µrad; empty if only
            one side was measured.
    """

    calibration: Calibration
    orders: dict[str, int]
    held_out: dict[str, float]
    reversal: dict[str, tuple[float, float]]
    chi2: float
    dof: int

    @property
    def p_value(self) -> float:
        """Probability of a misfit at least as large if these curves describe the motions completely."""
        return float(chi2_sf(self.chi2, self.dof)) if self.dof > 0 else float("nan")


def axis_curves(
    motions: Motions, machine: Machine, *, source: str, wanted: Callable[[str], bool] = lambda name: True
) -> AxisCurves:
    """Fit the six curves of the axis, each with the order that predicts held-out positions best.

    Generalised least squares with the joint covariance of all motions at all positions, so that the curves' covariance includes the
    common influence of the installation. Constants, slopes of straightness and reversal values are estimated as well but
    are not part of the curves.

    ``wanted``: whether a curve of that name is to be fitted.

    Raises `InputError`: fewer than `FEWEST` positions; no curve to fit.
    """
    index = machine.names.index(motions.axis)
    positions = np.zeros((len(motions), len(machine.axes)))
    positions[:, index] = motions.position_mm
    distinct = np.unique(motions.position_mm)
    if len(distinct) < FEWEST:
        raise InputError(
            f"too few positions of {motions.axis}",
            expected=f"{FEWEST} or more",
            value=count_with_noun(len(distinct), "position"),
        )
    bases = dict.fromkeys(machine.names, POWER)
    spaces, _ = spaces_for(machine, positions, bases=bases, most=MOST, wanted=wanted)
    if not spaces:
        raise InputError("no curve selected", expected=f"names of {motions.axis}'s error motions", value=motions.axis)
    both = np.any(motions.approach > 0.0) and np.any(motions.approach < 0.0)
    side = [motions.approach[:, None] / 2.0] if both else []
    chosen: dict[str, CurveSpace] = {}
    held_out: dict[str, float] = {}
    for letter in NAMES:
        name = f"E_{letter}{motions.axis}"
        space = next((one for one in spaces if one.name == name), None)
        if space is None:
            continue
        count, error = _order(space, motions, side, NAMES.index(letter))
        chosen[name] = CurveSpace(name, space.basis, space.domain, space.first, count)
        held_out[name] = error
    return _fitted(motions, machine, chosen, side, source, held_out)


def _order(space: CurveSpace, motions: Motions, side: list[np.ndarray], component: int) -> tuple[int, float]:
    """Return the number of functions that predicts best, and its error, by holding out one position (all its states) at a time."""
    y = motions.values[:, component]
    w = np.sqrt(motions.count)
    best, least = space.first, np.inf
    for count in range(space.first, space.count + 1):
        a = np.concatenate([space.functions(motions.position_mm)[:, :count], *side], axis=1) * w[:, None]
        q, _ = np.linalg.qr(a)
        residual = y * w - q @ (q.T @ (y * w))
        total = 0.0
        for position in np.unique(motions.position_mm):
            rows = motions.position_mm == position
            held = np.eye(int(rows.sum())) - q[rows] @ q[rows].T
            total += float(np.sum((np.linalg.pinv(held, rcond=1e-10) @ residual[rows]) ** 2))
        error = float(np.sqrt(total / np.sum(w**2)))
        if error < least * (1.0 - IMPROVEMENT):
            best, least = count, error
    return best, least


def _fitted(
    motions: Motions,
    machine: Machine,
    chosen: dict[str, CurveSpace],
    side: list[np.ndarray],
    source: str,
    held_out: dict[str, float],
) -> AxisCurves:
    g = len(motions)
    blocks = []
    places: dict[str, int] = {}
    start = 0
    for name, space in chosen.items():
        part = np.concatenate([space.functions(motions.position_mm)[:, : space.count], *side], axis=1)
        block = np.zeros((g, 6, part.shape[1]))
        block[:, NAMES.index(name[2])] = part
        blocks.append(block.reshape(6 * g, -1))
        places[name] = start
        start += part.shape[1]
    design = np.concatenate(blocks, axis=1)
    rows = np.tile([f"E_{letter}{motions.axis}" in chosen for letter in NAMES], g)
    try:
        factor = np.linalg.cholesky(motions.covariance[np.ix_(rows, rows)])
    except np.linalg.LinAlgError:
        raise InputError(
            f"covariance of {motions.axis}'s motions is numerically singular",
            expected="readings of one layout, and stated uncertainties of similar size",
        ) from None
    whitened = np.linalg.solve(factor, design[rows])
    right = np.linalg.solve(factor, motions.values.reshape(-1)[rows])
    q, r = np.linalg.qr(whitened)
    theta = np.linalg.solve(r, q.T @ right)
    inverse = np.linalg.inv(r)
    covariance = inverse @ inverse.T
    residual = right - whitened @ theta
    unknowns = Unknowns(machine, [space for space in chosen.values() if space.count > space.first], [])
    at = [places[column.entity] + column.index for column in unknowns.columns]
    calibration, _ = unknowns.calibration(
        theta[at], list(range(len(at))), source, read_only(covariance[np.ix_(at, at)])
    )
    reversal = {}
    if side:
        for name, space in chosen.items():
            k = places[name] + space.count
            reversal[name] = (float(theta[k]), float(np.sqrt(covariance[k, k])))
    curves = AxisCurves(
        calibration=calibration,
        orders={name: space.count for name, space in chosen.items() if space.count > space.first},
        held_out=held_out,
        reversal=reversal,
        chi2=float(residual @ residual),
        dof=len(right) - len(theta),
    )
    return replace(curves, calibration=_with_measurement(curves, motions))


def disagreements(motions: Motions, curves: AxisCurves) -> tuple[Message, ...]:
    """Return how the readings contradict the stated uncertainties or the curves; empty if they do not."""
    disagreements = []
    if motions.p_value < SIGNIFICANCE:
        disagreements.append(
            Message(
                "readings of the beams disagree by more than stated (chi² {chi2:.0f} for {dof} degrees of freedom): a "
                "beam, the layout or its uncertainties are not as stated",
                chi2=motions.chi2,
                dof=motions.dof,
            )
        )
    if curves.p_value < SIGNIFICANCE:
        disagreements.append(
            Message(
                "the motions deviate from the curves by more than their uncertainty (chi² {chi2:.0f} for {dof} degrees of "
                "freedom): short-wave errors, or more noise than stated",
                chi2=curves.chi2,
                dof=curves.dof,
            )
        )
    return tuple(disagreements)


def _with_measurement(curves: AxisCurves, motions: Motions) -> Calibration:
    """Return the calibration of the curves with how it was measured, its misfit, and the errors that one axis does not show."""
    calibration, wrong = curves.calibration, disagreements(motions, curves)
    machine = calibration.machine
    own = [f"E_{letter}{motions.axis}" for letter in NAMES]
    carriage = machine.by_name[motions.axis].side
    return replace(
        calibration,
        simulated=motions.simulated,
        instruments=(motions.instrument,),
        set_up=MeasuredWith(
            stations=1,
            targets_on_tool=motions.mirrors if carriage == "tool" else 0,
            targets_on_work=motions.mirrors if carriage == "work" else 0,
            points=int(motions.count.sum()),
        ),
        misfit=MisfitEntry(
            verdict="larger" if wrong else "untested" if min(curves.dof, motions.dof) < 1 else "consistent",
            says="; ".join(wrong),
            reduced_chi2=motions.chi2 / motions.dof if motions.dof > 0 else None,
            dof=max(motions.dof, 0),
            p_value=motions.p_value if motions.dof > 0 else None,
            lack_of_fit_p_value=curves.p_value if curves.dof > 0 else None,
        ),
        not_identifiable=not_measured(machine, own, (motions.axis,), NO_REFERENCE),
        not_estimated=tuple(name for name in own if name not in curves.held_out),
    )


# --- Report of a run: as text, and as JSON (``schema: twin.axis_run/1``) --------------------------

SCHEMA: Final = "twin.axis_run/1"
REPEAT_RATIO: Final = 3.0
"""Ratio of the standard deviation of repeats to the noise of the beams above which it is reported."""


def notices(motions: Motions, curves: AxisCurves) -> tuple[Message, ...]:
    """Return the facts to know before using the result."""
    notices = list(disagreements(motions, curves))
    own = np.sqrt(np.einsum("nii->ni", motions.displacement.noise_covariance)).mean(axis=0) * 1e6
    varying = [i for i in range(6) if motions.spread == "stated" and motions.repeatability[i] > REPEAT_RATIO * own[i]]
    if varying:
        names = ", ".join(f"E_{NAMES[i]}{motions.axis}" for i in varying)
        notices.append(
            Message(
                "{names}: repeats vary more than the beams' noise explains; base the uncertainty on repeats",
                names=names,
            )
        )
    return tuple(notices)


def to_dict(layout: AxisLayout, readings: BeamReadings, motions: Motions, curves: AxisCurves) -> dict[str, Any]:
    """Return the report as JSON."""
    installation, names = motions.displacement, [f"E_{letter}{motions.axis}" for letter in NAMES]
    installation_u, u = np.sqrt(np.diag(installation.installation_covariance)), motions.u
    entry = {
        "schema": SCHEMA,
        "layout": layout.name,
        "axis": motions.axis,
        "data": readings.source,
        "rows": {"used": len(readings), "set_aside": len(readings.set_aside)},
        "uncertainty": motions.spread,
        "motions": [
            {"position_mm": motions.position_mm[g], "approach": int(motions.approach[g]), "rows": motions.count[g]}
            | {
                name: {"value": motions.values[g, i], "u": u[g, i], "u_installation": motions.u_installation[g, i]}
                for i, name in enumerate(names)
            }
            for g in range(len(motions))
        ],
        "curves": {
            name: {"functions": count, "held_out": curves.held_out[name]} for name, count in curves.orders.items()
        },
        "reversal": {name: {"value": value, "u": u} for name, (value, u) in curves.reversal.items()},
        "repeatability": dict(zip(names, motions.repeatability, strict=True)),
        "misfit": {"chi2": motions.chi2, "dof": motions.dof, "p_value": motions.p_value},
        "curves_misfit": {"chi2": curves.chi2, "dof": curves.dof, "p_value": curves.p_value},
        "installation": [
            {"name": name, "estimate": estimate, "u_stated": stated, "u": after}
            for name, estimate, stated, after in zip(
                layout.beams.installation, installation.installation, layout.installation_u, installation_u, strict=True
            )
        ],
        "warnings": warnings_to_json(curves.calibration.warnings),
        "notices": [*readings.notices, *notices(motions, curves)],
        "set_aside": [{"line": note.line, "reason": note.text} for note in readings.set_aside],
    }
    return dict(json_form(entry))


def to_text(layout: AxisLayout, readings: BeamReadings, motions: Motions, curves: AxisCurves) -> str:
    """Return the report as text."""
    lines = [
        f"{layout.name}: {motions.axis}, {count_with_noun(len(readings), 'row')}, "
        f"{count_with_noun(len(np.unique(motions.position_mm)), 'position')}, "
        f"counters zeroed at {layout.reference_mm:g} mm",
        *warning_texts(curves.calibration.warnings),
        f"misfit: chi² {motions.chi2:.0f} for {motions.dof} degrees of freedom (p = {motions.p_value:.2g})",
        "",
        "error motion      range   functions   held out   u, largest   of it installation   reversal",
    ]
    for i, letter in enumerate(NAMES):
        name = f"E_{letter}{motions.axis}"
        if name not in curves.held_out:
            continue
        unit = "µm  " if i < 3 else "µrad"
        turned = curves.reversal.get(name)
        lines.append(
            f"{name}   {np.ptp(motions.values[:, i]):10.3f} {unit}   {curves.orders.get(name, 0):5d}   {curves.held_out[name]:10.4f}"
            f"   {motions.u[:, i].max():10.4f}   {motions.u_installation[:, i].max():18.4f}   "
            + ("" if turned is None else f"{turned[0]:+.4f} ± {turned[1]:.4f}")
        )
    lines += ["", *(f"note: {text}" for text in (*readings.notices, *notices(motions, curves)))]
    lines += [f"set aside, {text}" for text in grouped_notes(readings.set_aside)]
    return "\n".join(lines).rstrip() + "\n"
