"""Result of an identification: values, report and JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, final

import casadi as ca
import numpy as np

from twin._common.arrays import read_only
from twin._common.messages import Message
from twin._common.provenance import warning_texts, warnings_to_json
from twin._common.records import json_form
from twin._common.units import MM, UM, URAD, count_with_noun
from twin.display import Cell, note, table
from twin.display.numbers import COVERAGE_FACTOR
from twin.display.results import Display, DisplayedResult
from twin.identification.discrepancy import Discrepancy
from twin.identification.inputs import NoiseOfReadings, certificate_notices
from twin.identification.network import Network, Unknowns
from twin.identification.orders import Choice, HeldOutResiduals
from twin.identification.solve import FitSolution, FitStatistics, Spread, misfit
from twin.identification.unidentified import ConstantErrors, InstrumentShare, Unidentified
from twin.machine.chain import frame_pose
from twin.measurement.columns import RowNote, assumptions, grouped_notes
from twin.measurement.set_up import TOOL_SIZES, StationsAndTargets
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.calibration_file import MisfitEntry
from twin.model.datum.conditions import EXPLANATION
from twin.model.display import errors_html, standard_uncertainty
from twin.model.effects import split_name, unit_of
from twin.model.unknown_errors import error_vector
from twin.numerics.curves import basis_named
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
        locations = [name for name in names if name in calibration.location]
        if not locations:
            return None
        at = {axis.name: float(np.clip(0.0, *_range(axis.lower, axis.upper))) for axis in carrying}
        q = ca.SX([at.get(axis.name, 0.0) * axis.scale for axis in machine.axes])
        lines = calibration.where(lambda name: name in locations)
        e = ca.SX.sym("e", 6 * len(machine.frames))
        turned, nominal = (
            frame_pose(machine, machine.work_frame, q, error).rotation for error in (e, ca.SX(e.shape[0], 1))
        )
        angles = fused_angles(turned @ nominal.T)
        rates = ca.Function("table", [e], [angles, ca.jacobian(angles, e)])
        value, rate = rates(ca.evalf(error_vector(machine, lines.effects, q)))
        frames = [(frame.axis, frame.role) for frame in machine.frames]
        slots = [6 * frames.index((split_name(name)[2], "location")) + split_name(name)[0] for name in locations]
        jacobian = np.asarray(rate)[:, slots]
        known = set(locations) <= set(calibration.covariance.names)
        matrix = (
            calibration.covariance.of(locations).matrix if known else np.full((len(locations), len(locations)), np.nan)
        )
        covariance = jacobian @ matrix @ jacobian.T
        return cls(
            tuple(at.items()),
            read_only(np.asarray(value).ravel() / URAD),
            read_only(np.sqrt(np.diag(covariance))),
            read_only(covariance),
            tuple(name for name in names if name not in locations),
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


# --- Result of an identification: values, report and JSON -----------------------------------------

SCHEMA = "twin.identification/1"
SIGNIFICANCE = 1e-3
"""Significance level of the tests for a misfit."""
CONSISTENT = "consistent with the noise of the readings"
FEWEST_DOF = 10
"""Degrees of freedom below which chi² is not informative: at ten, a misfit as large as the noise gives p = 0.03."""
POOR_PREDICTION = 2.0
"""Held-out RMS over RMS of the fit, above which the fit does not predict other positions: it uses three quarters of the readings."""
THESIS_FUNCTIONS = 9
"""Number of functions of the thesis's degree 8."""


@final
@dataclass(frozen=True, repr=False)
class Identification(DisplayedResult):
    """An estimate of a machine's errors from measured points.

    Attributes:
        calibration: the errors that the data determine, with their joint covariance.
        unidentified: errors that the data do not determine.
        held_by_prior: errors among these that are in the calibration nevertheless, because others refer to them, with the standard
            deviation of their prior (of a curve, that of its first function, estimated with all curves), µm or µrad.
        setup: stations and targets as estimated.
        constants: which constant errors the readings determine; None if no axis with any moved.
        shares: the part of each instrument; empty if there is only one.
        setup_u: standard uncertainty of each of their parameters, by name; metres and radians.
        misfit: chi², lack of fit, pure error.
        held_out: residuals at held-out poses; None if there are too few poses.
        discrepancy: residuals beyond the noise; it is in the weights and in the covariance.
        choice: number of functions of each curve, and prediction errors of the alternatives.
        data: the rows used and the outliers.
        used: (n,) which rows were used.
        residual_mm: (n, 3) measured minus predicted, in each station's frame; NaN where nothing was read.
        whitened: (n, 3) residuals divided by the stated standard deviations.
        set_aside, notices: facts to know before using the result.
        converged: whether the estimate converged.
        network, solution: the least-squares problem and its solution.
    """

    calibration: Calibration
    unidentified: tuple[Unidentified, ...]
    held_by_prior: Mapping[str, float]
    setup: StationsAndTargets
    constants: ConstantErrors | None
    shares: tuple[InstrumentShare, ...]
    setup_u: Mapping[str, float]
    misfit: FitStatistics
    held_out: HeldOutResiduals | None
    discrepancy: Discrepancy
    choice: Choice
    noise: NoiseOfReadings
    data: Measurements
    used: np.ndarray
    residual_mm: np.ndarray
    whitened: np.ndarray
    set_aside: tuple[RowNote, ...]
    notices: tuple[Message, ...]
    converged: bool
    network: Network
    solution: FitSolution

    @property
    def complete(self) -> bool:
        """Whether every row was used, the estimate converged, and no certificate contradicts the readings."""
        return self.converged and not self.set_aside and not certificate_notices(self.network, self.setup)

    @property
    def spread(self) -> Spread:
        """Noise on which the covariance is based (`Spread`)."""
        return self.noise.spread

    @property
    def held_out_rms_um(self) -> float | None:
        """RMS of the residuals per coordinate at held-out poses; None with fewer than two poses."""
        return None if self.held_out is None else self.held_out.rms_um

    @property
    def verdict(self) -> str:
        """Whether the model fits the readings, or there are too few of them to decide."""
        return _judged(self.misfit, self.held_out)[1]

    @cached_property
    def rms_um(self) -> float:
        """RMS of the residuals of the coordinates that were used."""
        return rms_um(self.residual_mm[self.used])

    @cached_property
    def rms_all_um(self) -> float:
        """RMS of the residuals of all coordinates, outliers included."""
        return rms_um(self.residual_mm)

    def evaluated_with(self, calibration: Calibration) -> Identification:
        """Return the result with the residuals recomputed from a calibration that was read back from its file."""
        residual, whitened = residuals_of(calibration, self.network, self.setup)
        read, certified = self.network.read, self.network.certified(self.setup)[:, -1]
        return replace(
            self,
            calibration=calibration,
            residual_mm=read_only(np.where(read, residual / MM, np.nan)),
            whitened=read_only(whitened),
            misfit=misfit(whitened, read, self.data, self.solution.determined, self.used, certified),
        )

    def residuals_mm(self, data: Measurements) -> np.ndarray:
        """Return (n, 3) the residuals of other data from the same stations and targets, mm; NaN where nothing was read.

        Args:
            data: measurements that were not used in this estimate.

        Raises:
            KeyError: a station or target that is not part of this estimate.
        """
        other = Network(self.network.machine, data, self.network.instruments, self.network.unknowns)
        residual = other.residuals_m(self.solution.theta, self.setup.of(data), np.arange(len(data)))
        return read_only(np.where(other.read, residual / MM, np.nan))

    def interval(self, name: str, q: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return an error motion and its standard uncertainty.

        Args:
            name: ISO 230-1 name of a curve of the calibration.
            q: positions, mm or degrees.

        Returns:
            Value and standard uncertainty at each position, µm or µrad.
        """
        curve = self.calibration.curves[name]
        values = curve(q)
        effect = next(e for e in self.calibration.effects if e.name == name)
        u = standard_uncertainty(effect, self.calibration.covariance, np.asarray(q, dtype=float))
        return read_only(np.asarray(values)), read_only(u)

    def rows(self) -> list[dict[str, Any]]:
        """Return one entry for each error: name, unit, order, peak over the range, largest standard uncertainty, held-out errors."""
        rows: list[dict[str, Any]] = []
        for name, curve in self.calibration.curves.items():
            value, u = self.interval(name, np.linspace(*curve.domain, 201))
            count = self.choice.counts[name]
            rows.append(
                {
                    "name": name,
                    "unit": curve.unit,
                    "basis": curve.basis,
                    "order": curve.family.order(count),
                    "peak": float(np.abs(value).max()),
                    "u_max": float(u.max()),
                    "held_out": self.choice.by_curve.get(name, {}).get(count),
                    "held_out_thesis": _score_up_to(self.choice.by_curve.get(name, {}), THESIS_FUNCTIONS),
                }
            )
        for name, number in (*self.calibration.squareness.items(), *self.calibration.location.items()):
            u_number = float(np.sqrt(self.calibration.covariance.of([name]).matrix[0, 0]))
            unit = unit_of(name)
            rows.append({"name": name, "unit": unit, "value": number, "u": u_number})
        return rows

    def _tools(self) -> dict[str, dict[str, dict[str, float]]]:
        """Return deviation and standard uncertainty, µm, of the sizes of each tool that cut a measured part."""
        sizes: dict[str, dict[str, dict[str, float]]] = {}
        for i, name in enumerate(self.setup.tools):
            sizes[name] = {
                size: {"value_um": float(self.setup.tool[i, k]) / UM, "u_um": self.setup_u[f"tool {name} {size}"] / UM}
                for k, size in enumerate(TOOL_SIZES)
                if self.setup.tool_acts[i, k]
            }
        return sizes

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON (``schema: twin.identification/1``)."""
        order, table = self.setup, TableTilt.of(self.calibration)
        stations = {}
        for i, name in enumerate(order.stations):
            stations[name] = {
                "instrument": order.reads[i].name,
                "origin_mm": order.origin[i] / MM,
                "known": order.station_known[i],
            }
            if order.reads[i].free_start:
                stations[name]["dead_path_mm"] = order.dead[i] / MM
        entry = {
            "schema": SCHEMA,
            "machine": self.calibration.machine.name,
            "datum": self.calibration.datum,
            "data": self.data.source,
            "points": {"used": int(self.used.sum()), "set_aside": len(self.set_aside)},
            "verdict": self.verdict,
            "uncertainty": self.spread,
            "errors": self.rows(),
            "constants": self.constants,
            "instruments": self.shares,
            "table": table,
            "not_identifiable": [
                {
                    "name": error.name,
                    "reason": error.reason,
                    "direction": error.direction,
                    "prior": self.held_by_prior.get(error.name),
                }
                for error in self.unidentified
            ],
            "stations": stations,
            "targets": {
                name: {"place_mm": order.place[i] / MM, "known": order.target_known[i]}
                for i, name in enumerate(order.targets)
            },
            **({"tools": self._tools()} if self.setup.tools else {}),
            "misfit": self._misfit(),
            "noise": {"contradicted_by_repeats": self.noise.contradicted, "assumed": self.noise.assumed},
            "orders": {
                "held_out_rms": self.choice.held_out,
                "uniform": self.choice.uniform,
                "readings_held_out": self.choice.readings,
            },
            "set_aside": [{"line": note.line, "reason": note.text} for note in self.set_aside],
            "certificates": [artefact.to_dict() for artefact in self.data.artefacts],
            "notices": self.notices,
            "converged": self.converged,
            "warnings": warnings_to_json(self.calibration.warnings),
        }
        return dict(json_form(entry))

    def _misfit(self) -> dict[str, Any]:
        """Return the residuals compared with the noise, at held-out poses, and beyond the noise."""
        fit = self.misfit
        return {
            "rms_um": self.rms_um,
            "rms_all_um": self.rms_all_um,
            "chi2": fit.chi2,
            "dof": fit.dof,
            "reduced_chi2": fit.reduced,
            "p_value": fit.p_value,
            "pure_error": {"chi2": fit.pure_chi2, "dof": fit.pure_dof, "reduced": fit.pure_reduced},
            "lack_of_fit_p_value": fit.lack_p_value,
            "held_out_rms_um": self.held_out_rms_um,
            "held_out": self.held_out,
            "discrepancy": self.discrepancy.to_dict(),
        }

    @property
    def brief(self) -> str:
        """Numbers of points and errors, residuals and verdict."""
        points = f"{count_with_noun(int(self.used.sum()), 'point')}, {count_with_noun(len(self.unidentified), 'error')} not identified"
        return f"{self.calibration.machine.name}: {points}; {self.rms_um:.3g} µm RMS per coordinate; {self.verdict}"

    def display(self) -> Display:
        """Return verdict, residuals, all errors, and those that are not identifiable."""
        fit, tilt = self.misfit, TableTilt.of(self.calibration)
        residuals = f"{self._rms_text()}; {_fit_text(fit)}"
        rows: list[tuple[str, Cell]] = [
            ("data", self.data.source),
            ("points", f"{int(self.used.sum()):,} used, {len(self.set_aside):,} set aside"),
            ("residuals", residuals),
            ("held-out poses", "" if self.held_out is None else self.held_out.text),
            ("beyond the noise", self.discrepancy.text),
            ("intervals from", self._based_on),
            ("stations", ", ".join(self.setup.stations)),
            ("targets", ", ".join(self.setup.targets)),
            ("", "" if tilt is None else tilt.to_text(COVERAGE_FACTOR)),
        ]
        errors = errors_html(self.calibration.machine, self.calibration.effects, self.calibration.covariance)
        hidden = [(", ".join(names), why) for why, names in self._by_reason().items()]
        aside = [note(f"set aside: {grouped_note}", loud=True) for grouped_note in grouped_notes(self.set_aside)]
        notes = [*aside, *(note(notice, loud=notice in self._loud) for notice in self.notices)]
        if not self.converged:
            notes.insert(0, note("THE ESTIMATE DID NOT CONVERGE: do not use it", loud=True))
        if self.held_by_prior:
            notes.append(note(self._prior_text()))
        unseen = table(("not identifiable", "why"), hidden)
        doubted = not self.complete or self.verdict != CONSISTENT
        title = f"Identification of {self.calibration.machine.name}"
        above, below = (note(self.verdict, loud=doubted),), (errors, unseen, *notes)
        return Display(title, rows, above=above, below=below, wrong=doubted)

    def to_text(self) -> str:
        """Return the report as text."""
        fit = self.misfit
        stations = len(self.setup.stations)
        lines = [
            f"{self.calibration.machine.name}: {count_with_noun(int(self.used.sum()), 'point')} of "
            f"{count_with_noun(len(self.setup.targets), 'target')} from {count_with_noun(stations, 'station')}, "
            f"{self.solution.determined:.0f} parameters determined",
            *warning_texts(self.calibration.warnings),
            *self._loud,
            "",
            f"residuals: {self._rms_text()}; {_fit_text(fit)}",
        ]
        if fit.pure_dof:
            lines.append(
                f"repeats: reduced chi² {fit.pure_reduced:.3f} ({fit.pure_dof} degrees of freedom); lack of fit "
                + ("cannot be tested" if np.isnan(fit.lack_p_value) else f"p = {fit.lack_p_value:.2g}")
            )
        lines += [] if self.held_out is None else [f"at held-out poses: {self.held_out.text}"]
        if self.discrepancy.parts:
            lines.append(
                f"discrepancy of the model beyond the noise: {self.discrepancy.text}; the readings are weighted with it"
            )
        lines += [f"  {share.text}" for share in self.shares]
        lines += [self.verdict, "", f"error motions (95 % intervals from {self._based_on}):"]
        lines += [_row_text(row) for row in self.rows()]
        table = TableTilt.of(self.calibration)
        lines += [] if table is None else [f"  {table.to_text(COVERAGE_FACTOR)}"]
        for name, sizes in self._tools().items():
            said = (
                f"{size} {one['value_um']:+.1f} ± {COVERAGE_FACTOR * one['u_um']:.1f} µm" for size, one in sizes.items()
            )
            lines.append(f"  tool {name} differs from its nominal size: {', '.join(said)}")
        lines += [
            "  The degree is chosen by prediction of held-out data; 0: nothing above the noise. The intervals include possible",
            "  components of higher degree.",
            f"  {EXPLANATION[self.calibration.datum]}",
        ]
        if self.constants is not None and self.constants.lost:
            lines += ["", self.constants.text]
        if self.unidentified:
            lines += ["", "not identifiable from these data:"]
            lines += [f"  {', '.join(names)}: {reason}" for reason, names in self._by_reason().items()]
        if self.held_by_prior:
            lines += [f"  {self._prior_text()}"]
        lines += [f"  {text}" for text in self._tip_texts()]
        degree8 = _score_up_to(self.choice.uniform, THESIS_FUNCTIONS)
        if degree8 is not None:
            text = f"{self.choice.held_out:.4f} as chosen, {degree8:.4f} with degree 8 everywhere"
            lines += ["", f"RMS of held-out residuals without priors, in standard deviations of the weights: {text}"]
        if self.set_aside:
            lines += [
                "",
                f"set aside ({len(self.set_aside)}):",
                *(f"  {grouped_note}" for grouped_note in grouped_notes(self.set_aside)),
            ]
        lines += [f"note: {notice}" for notice in self.notices if notice not in self._loud]
        if not self.converged:
            lines.append("THE ESTIMATE DID NOT CONVERGE: do not use it")
        return "\n".join(lines) + "\n"

    def _tip_texts(self) -> Iterator[str]:
        """Yield the place of each probe's tip that was estimated: a wrong length shows in it, and in nothing else."""
        setup = self.setup
        for name, reads, origin, known in zip(
            setup.stations, setup.reads, setup.origin, setup.station_known, strict=True
        ):
            if reads.reads == "null" and not known:
                place = ", ".join(f"{value / MM:.3f}" for value in origin)
                yield f"tip of {name}: {place} mm from the spindle nose, if the errors that it imitates are zero; compare its length"

    @property
    def _based_on(self) -> str:
        """Noise on which the intervals are based, in words."""
        return self.noise.interval_text(incomplete=bool(self.discrepancy.parts))

    @property
    def _loud(self) -> list[str]:
        """Notices that are printed before any result: assumptions, and what the repeats contradict."""
        return list(dict.fromkeys((*assumptions(self.notices), *self.noise.notices)))

    def _rms_text(self) -> str:
        """Return the RMS of the rows used, and of all rows if some were not used."""
        text = f"{self.rms_um:.3g} µm RMS per coordinate"
        return text if self.used.all() else f"{text} over the rows used, {self.rms_all_um:.3g} µm over all"

    def _prior_text(self) -> str:
        """Return a sentence on the confounded errors in the calibration and their priors."""
        by_unit: dict[str, list[str]] = {}
        for name, size in self.held_by_prior.items():
            by_unit.setdefault("µm" if unit_of(name) == "um" else "µrad", []).append(f"{name} {size:.3g}")
        each = "; ".join(f"{', '.join(sizes)} {unit}" for unit, sizes in by_unit.items())
        return (
            "kept in the calibration, because other errors refer to them, with a prior about zero (k = 1; of a curve, that of its "
            f"first function, from the sizes of all curves): {each}"
        )

    def _by_reason(self) -> dict[str, list[str]]:
        names_by_reason: dict[str, list[str]] = {}
        for error in self.unidentified:
            names_by_reason.setdefault(error.reason, []).append(error.name)
        return names_by_reason


def rms_um(residual_mm: np.ndarray) -> float:
    """Return the RMS of residuals, given in millimetres and NaN where nothing was read, in micrometres."""
    return float(np.sqrt(np.nanmean(residual_mm**2))) * 1e3


def residuals_of(
    calibration: Calibration, network: Network, setup: StationsAndTargets
) -> tuple[np.ndarray, np.ndarray]:
    """Evaluate a calibration on the rows of an estimate.

    ``calibration``: the calibration; it need not consist of the estimate's own unknowns.

    Returns:
        (n, 3) measured minus predicted, metres, zero where nothing was read; (n, 3) the same divided by the stated standard deviations.
    """
    no_unknowns = Unknowns(network.machine, (), ())
    alone = Network(
        network.machine, network.data, network.instruments, no_unknowns, calibration, network.covariance, check=False
    )
    residual = alone.residuals_m(np.zeros(0), setup, np.arange(len(network.data)))
    return residual, np.einsum("nij,nj->ni", network.whitening, residual)


def _row_text(row: Mapping[str, Any]) -> str:
    unit = "µm" if row["unit"] == "um" else "µrad"
    if "peak" not in row:
        return f"  {row['name']:<7}      {row['value']:8.2f} {unit:<4} ± {COVERAGE_FACTOR * row['u']:6.2f}"
    kind = basis_named(row["basis"]).order_noun
    half = COVERAGE_FACTOR * row["u_max"]
    return f"  {row['name']:<7} peak {row['peak']:8.2f} {unit:<4} ± {half:6.2f} at most, {kind} {row['order']}"


Verdict = Literal["consistent", "systematic", "larger", "untested"]


def _judged(fit: FitStatistics, at_poses: HeldOutResiduals | None) -> tuple[Verdict, str]:
    """Return whether the model fits, as in a calibration file and as a sentence.

    ``at_poses``: residuals at held-out poses; None if there are too few poses.
    """
    if fit.dof < 1:
        return (
            "untested",
            "NO DEGREES OF FREEDOM: as many parameters as readings, so the model cannot be tested. Measure more positions or rounds.",
        )
    if fit.lack_p_value == fit.lack_p_value and fit.lack_p_value < SIGNIFICANCE:
        return (
            "systematic",
            "SYSTEMATIC RESIDUALS: the model is incomplete. The intervals below count them as random from pose to pose. "
            "Run `twin diagnose`.",
        )
    if fit.p_value < SIGNIFICANCE:
        return (
            "larger",
            "RESIDUALS LARGER THAN THE STATED UNCERTAINTY: the model is incomplete, or the uncertainty is too small. "
            "The intervals below count them as random from pose to pose.",
        )
    if fit.dof < FEWEST_DOF:
        return (
            "untested",
            f"TOO FEW DATA to test the model: {fit.dof:.0f} degrees of freedom. Measure more positions or rounds.",
        )
    if at_poses is not None and at_poses.whitened_rms > POOR_PREDICTION * max(1.0, float(np.sqrt(fit.reduced))):
        return (
            "untested",
            "TOO FEW POSITIONS to test the model: the fit is good, but residuals at held-out positions are "
            f"{at_poses.whitened_rms:.1f} standard deviations RMS (about 1 if the model holds there). Measure more positions.",
        )
    return "consistent", CONSISTENT


def misfit_entry(fit: FitStatistics, rms: float, at_poses: HeldOutResiduals | None) -> MisfitEntry:
    """Return the misfit as it is written into the calibration.

    ``rms``: RMS of the residuals of a coordinate, µm; ``at_poses``: residuals at held-out poses; None if there are too few poses.
    """
    verdict, says = _judged(fit, at_poses)
    numbers = {
        "reduced_chi2": fit.reduced,
        "p_value": fit.p_value,
        "lack_of_fit_p_value": fit.lack_p_value,
        "rms_um": rms,
        "held_out_rms_um": np.nan if at_poses is None else at_poses.rms_um,
    }
    known = {name: value for name, value in numbers.items() if np.isfinite(value)}
    return MisfitEntry(verdict=verdict, says=says, dof=fit.dof, **known)


def _score_up_to(scores: Mapping[int, float], size: int) -> float | None:
    """Return the score at the largest number of functions up to ``size``."""
    fitting = [n for n in scores if n <= size]
    return scores[max(fitting)] if fitting and max(fitting) >= size - 1 else None


def _fit_text(fit: FitStatistics) -> str:
    if fit.dof <= 0:
        return "no degrees of freedom to test the fit"
    return f"reduced chi² {fit.reduced:.3f} ({fit.dof:.0f} degrees of freedom, p = {fit.p_value:.2g})"
