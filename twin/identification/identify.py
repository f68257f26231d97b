"""The estimate: from a measurement table to a calibration with its covariance, stage by stage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import require_type
from twin._common.resources import Progress, one_blas_thread, silent
from twin._common.units import MM
from twin.identification.discrepancy import covariance_of, many_outliers_notice, outlier_notes
from twin.identification.fitting import FinalEstimate, RobustStart, robust_start, shrunk_start, without_outliers
from twin.identification.inputs import (
    NoiseOfReadings,
    PreparedData,
    certificate_notices,
    implausible_tips,
    prepare,
    reading_noise,
)
from twin.identification.network import Network, Unknowns
from twin.identification.orders import Choice, choose, held_out_residuals
from twin.identification.result import Identification, misfit_entry, residuals_of, rms_um
from twin.identification.solve import FitSolution, Spread, misfit
from twin.identification.unidentified import (
    DeterminedModel,
    Wanted,
    constant_errors,
    determined_models,
    held_by_prior,
    instrument_shares,
    unidentified,
    unknown_reference,
)
from twin.machine.machine import Machine
from twin.measurement.certificate import Artefact
from twin.measurement.columns import CARRIERS, overstated_noise
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements
from twin.model.calibration_file import MeasuredWith, UnidentifiedEntry


@final
@dataclass(frozen=True)
class _Model:
    """The largest model in one family of bases, a robust estimate of it, and the number of functions of its curves."""

    determined: DeterminedModel
    start: RobustStart
    choice: Choice


def identify(
    data: Measurements,
    machine: Machine,
    *,
    instrument: Instrument | None = None,
    wanted: Wanted = lambda name: True,
    spread: Spread = "stated",
    artefacts: Sequence[Artefact] = (),
    progress: Progress = silent,
) -> Identification:
    """Identify a machine's error motions, squareness and locations together with stations and targets.

    Whitened nonlinear least squares with analytic derivatives of all readings with respect to all unknowns. The datum is the machine's
    own (`twin.identification.network`); the covariance is propagated from that of the readings and never scaled by chi².

    Args:
        data: the measurements.
        machine: the machine.
        instrument: the instrument; by default a tracking interferometer if only lengths were read, otherwise a laser tracker (AT960).
        wanted: whether an error of that ISO 230-1 name is to be estimated; all by default.
        spread: noise on which the covariance is based: the stated uncertainty of the readings; the standard deviation of their repeats;
            or the variation between poses or between rounds, for an incomplete model (`twin.identification.solve`).
        artefacts: known distances between targets, or their coordinates, from calibration certificates (`twin.Artefact.load`). Their
            covariance is in the likelihood like that of the readings.
        progress: callback for progress, called with the stage and the fraction done.

    Raises:
        InputError: data that cannot be a measurement of this machine; too few repeats for ``spread="repeats"``; no axis that moved.
        TypeError: a path instead of the object read from it.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> plan = twin.thesis_plan.plan(machine)
        >>> along_x = plan.select(plan.approach[:, 0] != 0)
        >>> truth, tracker = twin.Calibration.default(machine), twin.instruments.LaserTracker()
        >>> data, _ = twin.simulate(along_x, machine, truth, tracker, np.random.default_rng(1))
        >>> found = twin.identify(data, machine)
        >>> sorted(found.calibration.curves)
        ['E_AX', 'E_BX', 'E_CX', 'E_XX', 'E_YX', 'E_ZX']
        >>> found.calibration.save("identified.yaml")
        >>> twin.identification_plots.plot_motions(found, "X").savefig("motions.png")

    References:
        - H. D. Patterson, R. Thompson: Recovery of inter-block information when block sizes are unequal, Biometrika 58 (1971) 545-554.
        - A. Gelman: Prior distributions for variance parameters in hierarchical models, Bayesian Analysis 1 (2006) 515-534.
        - P. J. Huber: Robust estimation of a location parameter, Ann. Math. Statist. 35 (1964) 73-101.
    """
    require_type("data", data, Measurements)
    require_type("machine", machine, Machine)
    data = replace(data, artefacts=(*data.artefacts, *artefacts))
    with one_blas_thread():
        progress("placing the stations", 0.0)
        placed = prepare(machine, data, instrument)
        noise = reading_noise(machine, placed, spread, named=instrument is not None)
        progress("choosing the curves", 0.1)
        model = _best(determined_models(machine, placed, wanted, noise.covariance), placed)
        progress("estimating", 0.75)
        shrunk = shrunk_start(model.determined.network, model.start)
        estimate = without_outliers(model.determined.network, model.start, shrunk)
        progress("uncertainty", 0.9)
        return _result(model, estimate, noise, wanted)


def _best(candidates: list[DeterminedModel], placed: PreparedData) -> _Model:
    """Return the model that predicts held-out readings best; the first of equally good ones.

    All are compared with the weights of the one that leaves least: a discrepancy of its own would excuse a model that is wrong.
    """
    starts = [robust_start(of.network, placed.setup, of.triangle) for of in candidates]
    root = min(starts, key=lambda start: start.noise).discrepancy.root
    best, *others = [
        _Model(of, start, choose(of.network.with_discrepancy(root), start, of.confounded))
        for of, start in zip(candidates, starts, strict=True)
    ]
    for other in others:
        if other.choice.held_out < best.choice.held_out * (1.0 - 1e-6):
            best = other
    return best


def _result(model: _Model, estimate: FinalEstimate, noise: NoiseOfReadings, wanted: Wanted) -> Identification:
    network, (solution, discrepancy, rows) = model.determined.network, estimate
    data, unknowns, machine, used = network.data, network.unknowns, network.machine, ~rows.bad
    weighted = network.with_discrepancy(discrepancy.root)
    covariance = covariance_of(weighted, solution, used.astype(float), noise.spread, discrepancy)
    count = len(unknowns)
    source = f"identified by twin from {data.source}: {int(used.sum())} points" + "".join(
        f"; with certificate {artefact.number}" for artefact in data.artefacts
    )
    found, _ = unknowns.calibration(solution.theta, range(count), source, covariance[:count, :count])
    found = replace(found, settled=solution.converged, simulated=data.simulated)
    u = np.sqrt(np.maximum(np.diag(covariance)[count:], 0.0))
    held = held_by_prior(model.determined, solution, np.sqrt(np.diag(covariance)[:count]))
    residual, whitened = residuals_of(found, network, solution.setup)
    certified = network.certified(solution.setup)[:, -1]
    statistics = misfit(whitened, network.read, data, solution.determined, used, certified)
    residual_mm = read_only(np.where(network.read, residual / MM, np.nan))
    unknown = unidentified(machine, data, model.determined, wanted, solution.setup, held)
    held_out = held_out_residuals(weighted, solution, used)
    calibration = replace(
        found,
        not_identifiable=tuple(UnidentifiedEntry(name=one.name, why=one.why, remedy=one.remedy) for one in unknown),
        misfit=misfit_entry(statistics, rms_um(residual_mm[used]), held_out),
        **_measured_with(network, used, wanted),
    )
    return Identification(
        calibration=calibration,
        unidentified=unknown,
        held_by_prior={name: _prior_of(name, unknowns, solution) for name in held},
        setup=solution.setup,
        constants=constant_errors(machine, data, network.instruments, solution.setup, network.covariance),
        shares=instrument_shares(network, solution.setup, used, residual_mm, whitened),
        setup_u=dict(zip(solution.setup.names, (float(v) for v in u), strict=True)),
        misfit=statistics,
        held_out=held_out,
        discrepancy=discrepancy,
        choice=model.choice,
        noise=noise,
        data=data,
        used=read_only(used),
        residual_mm=residual_mm,
        whitened=read_only(whitened),
        set_aside=(*data.set_aside, *outlier_notes(network, residual, whitened, rows.bad)),
        notices=(
            *data.notices,
            *noise.notices,
            *implausible_tips(data, solution.setup),
            *overstated_noise(rms_um(residual_mm[used]), statistics.chi2, statistics.dof),
            *many_outliers_notice(rows),
            *certificate_notices(network, solution.setup),
            *unknown_reference(solution, unknowns),
        ),
        converged=solution.converged,
        network=network,
        solution=solution,
    )


def _prior_of(name: str, unknowns: Unknowns, solution: FitSolution) -> float:
    """Return the standard deviation of the prior of an error, of a curve that of its first function, µm or µrad."""
    first = unknowns.of(name)[0]
    variance = float(solution.priors.variance[first])
    return variance**0.5 if variance > 0.0 else float(unknowns.plausible[first])


def _measured_with(network: Network, used: np.ndarray, wanted: Wanted) -> dict[str, Any]:
    """Return the entries of the calibration on the measurement, and the errors left out on request."""
    data, machine = network.data, network.machine
    sides = {side: len(dict.fromkeys(data.target[data.carrier == side].tolist())) for side in CARRIERS}
    every = (*machine.motion_names, *machine.squareness_names, *machine.location_names)
    return {
        "instruments": tuple(one.name for one in network.instruments.every),
        "set_up": MeasuredWith(
            stations=len(dict.fromkeys(data.station.tolist())),
            targets_on_tool=sides["tool"],
            targets_on_work=sides["work"],
            points=int(used.sum()),
        ),
        "not_estimated": tuple(name for name in every if not wanted(name)),
    }
