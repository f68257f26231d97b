"""The estimate: from a measurement table to a calibration with its covariance, one stage after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from threadpoolctl import threadpool_limits

from twin._common.arrays import locked
from twin._common.units import MM
from twin.identification.determined import Determined, Wanted, determined
from twin.identification.inputs import Placed, prepared
from twin.identification.orders import Choice, choose
from twin.identification.outliers import explained, model_is_wrong
from twin.identification.priors import prior_precision
from twin.identification.result import Identification, residuals_of
from twin.identification.robust import FinalEstimate, Start, robust_start, without_outliers
from twin.identification.spread import Spread, covariance_from_repeats, covariance_of, misfit
from twin.identification.unidentified import held_by_prior, unidentified, unknown_reference
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements

Say = Callable[[str, float], None]


@final
@dataclass(frozen=True)
class _Model:
    """The largest model in one family of bases, a robust estimate of it, and how many functions of its curves pay."""

    determined: Determined
    start: Start
    choice: Choice


def identify(
    data: Measurements,
    machine: Machine,
    *,
    instrument: Instrument | None = None,
    wanted: Wanted = lambda name: True,
    spread: Spread = "stated",
    say: Say = lambda stage, part: None,
) -> Identification:
    """Identify a machine's error motions, squareness and locations together with stations and targets.

    Whitened nonlinear least squares with analytic derivatives of every reading by every unknown. The datum is the machine's own
    (`twin.identification.unknowns`); the covariance is that of the readings carried through, never rescaled by chi².

    Args:
        data: the measurements.
        machine: the machine.
        instrument: what read them; a tracking interferometer if only lengths were read, else a laser tracker (AT960).
        wanted: whether an error of that ISO 230-1 name is sought at all; all by default.
        spread: whose scatter the covariance carries: the stated uncertainty of the readings; the scatter of their repeats; or the
            scatter from pose to pose or from round to round, for a model that leaves something out (`twin.identification.spread`).
        say: told what is being done and how far it is.

    Raises:
        InputError: data that cannot be a measurement of this machine; too few repeats for ``spread="repeats"``; nothing that moved.
    """
    # On a shared machine the threads of a linear algebra library wait for each other longer than they work.
    with threadpool_limits(limits=1, user_api="blas"):
        say("placing the stations", 0.0)
        placed = prepared(machine, data, instrument)
        scatter = covariance_from_repeats(placed.data, placed.instrument) if spread == "repeats" else None
        say("choosing the curves", 0.1)
        model = _best([_model(one, placed) for one in determined(machine, placed, wanted, scatter)])
        say("estimating", 0.75)
        precision = prior_precision(model.determined.network, model.start)
        estimate = without_outliers(model.determined.network, model.start, precision)
        say("uncertainty", 0.9)
        used = (~estimate.rows.bad).astype(float)
        covariance = covariance_of(model.determined.network, estimate.solution, used, spread)
        return _result(model, estimate, covariance, spread, wanted)


def _model(of: Determined, placed: Placed) -> _Model:
    start = robust_start(of.network, placed.setup, of.triangle)
    return _Model(of, start, choose(of.network, start, of.together))


def _best(models: list[_Model]) -> _Model:
    """The model that predicts held-out readings best; of those that predict alike the first."""
    best, *others = models
    for other in others:
        if other.choice.held_out < best.choice.held_out * (1.0 - 1e-6):
            best = other
    return best


def _result(
    model: _Model, estimate: FinalEstimate, covariance: np.ndarray, spread: Spread, wanted: Wanted
) -> Identification:
    network, (solution, rows) = model.determined.network, estimate
    data, unknowns, machine, used = network.data, network.unknowns, network.machine, ~rows.bad
    count = len(unknowns)
    source = f"identified by twin from {data.source}: {int(used.sum())} points"
    found, _ = unknowns.calibration(solution.theta, range(count), source, covariance[:count, :count])
    calibration = replace(found, settled=solution.converged, simulated=data.simulated)
    u = np.sqrt(np.maximum(np.diag(covariance)[count:], 0.0))
    held = held_by_prior(model.determined, solution)
    left, whitened = residuals_of(calibration, network, solution.setup)
    return Identification(
        calibration=calibration,
        unidentified=unidentified(machine, data, model.determined, wanted, solution.setup, held),
        held_by_prior={name: float(machine.plausible(name)) for name in held},
        setup=solution.setup,
        setup_u=dict(zip(solution.setup.names, (float(v) for v in u), strict=True)),
        misfit=misfit(whitened, network.read, data, solution.determined, used),
        choice=model.choice,
        spread=spread,
        data=data,
        used=locked(used),
        residual_mm=locked(np.where(network.read, left / MM, np.nan)),
        whitened=locked(whitened),
        set_aside=(*data.set_aside, *explained(network, left, whitened, rows.bad)),
        notices=(*data.notices, *model_is_wrong(rows), *unknown_reference(solution, unknowns)),
        converged=solution.converged,
        network=network,
        solution=solution,
    )
