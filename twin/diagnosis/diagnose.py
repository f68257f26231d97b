"""The stages of a diagnosis: from measured data to errors beyond noise, their causes, and what these are confounded with."""

from __future__ import annotations

from twin._common.errors import require_type
from twin._common.resources import Progress, one_blas_thread, silent
from twin.diagnosis.answer import Diagnosis, conclude
from twin.diagnosis.causes import estimate_sizes
from twin.diagnosis.readings import readings
from twin.diagnosis.search import exclude_outliers
from twin.diagnosis.structure import select_causes
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration


def diagnose(
    data: Measurements,
    machine: Machine,
    calibration: Calibration | None = None,
    *,
    instrument: Instrument | None = None,
    empirical: bool = False,
    progress: Progress = silent,
) -> Diagnosis:
    """Find the errors that measured data show beyond the model, and their causes.

    The stages: place the stations (`readings`), set outliers aside (`exclude_outliers`), select causes and unnamed patterns
    (`select_causes`), estimate the sizes of the causes (`estimate_sizes`), and add alternatives, probabilities and what the causes
    leave and gain (`conclude`).

    Args:
        data: the measurements.
        machine: the machine.
        calibration: the model to be tested; the machine file's default if None.
        instrument: the instrument whose noise model is used; None to take the table's uncertainties or the spread of repeats.
        empirical: whether unexplained patterns of the machine extend the calibration too, without a known cause
            (`twin.diagnosis.gain`).
        progress: called with the present stage and the fraction done.

    Raises:
        InputError: data that cannot be a measurement of this machine.
        TypeError: a path instead of the object read from it.

    Examples:
        >>> from dataclasses import replace
        >>> machine = twin.Machine.load("dmu50")
        >>> model, tracker = twin.Calibration.default(machine), twin.instruments.LaserTracker()
        >>> hidden = twin.effect_named("cross_axis", "E_AY by Z", {"coefficient": 110.0}, machine)
        >>> plan, real = twin.thesis_plan.plan(machine), replace(model, extra=(hidden,))
        >>> data, _ = twin.simulate(plan, machine, real, tracker, np.random.default_rng(2))
        >>> diagnosis = twin.diagnose(data, machine, model, instrument=tracker)
        >>> cause = diagnosis.causes[0]
        >>> cause.effect, cause.where, round(cause.parameters[0].value), cause.parameters[0].unit
        ('cross_axis', 'E_AY by Z', 109, 'urad/m')
        >>> cause.equivalent  # the readings do not distinguish it from
        (('cross_axis', 'E_AX by Z'),)
        >>> twin.diagnosis_plots.plot_cause(diagnosis).savefig("cause.png")

    References:
        - G. Wang, A. Sarkar, P. Carbonetto, M. Stephens: A simple new approach to variable selection in regression, with application to
          genetic fine mapping, J. R. Statist. Soc. B 82 (2020) 1273-1300 (probabilities of the causes).
        - M. Stone: Cross-validatory choice and assessment of statistical predictions, J. R. Statist. Soc. B 36 (1974) 111-147 (number
          of causes).
        - A. C. Atkinson, V. V. Fedorov: The design of experiments for discriminating between two rival models, Biometrika 62 (1975)
          57-70 (next measurement).
    """
    require_type("data", data, Measurements)
    require_type("machine", machine, Machine)
    errors = Calibration.given(machine, calibration)
    with one_blas_thread():
        progress("placing the stations", 0.0)
        placed = readings(data, machine, errors, instrument)
        progress("searching for causes", 0.2)
        findings = select_causes(exclude_outliers(placed))
        progress("estimating their sizes", 0.7)
        return conclude(estimate_sizes(findings), errors, empirical=empirical)
