"""Given measured data: is there anything beyond noise, what is it, what could it be mistaken for."""

from __future__ import annotations

from collections.abc import Callable

from threadpoolctl import threadpool_limits

from twin.diagnosis.diagnosis import Diagnosis
from twin.diagnosis.judgement.answer import answer
from twin.diagnosis.judgement.causes import judged
from twin.diagnosis.judgement.sizes import sized
from twin.diagnosis.problem.readings import readings
from twin.diagnosis.selection.rows import diagnosis_task
from twin.diagnosis.selection.searcher import selected
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements

Say = Callable[[str, float], None]


def diagnose(
    data: Measurements,
    machine: Machine,
    calibration: Calibration | None = None,
    *,
    instrument: Instrument | None = None,
    empirical: bool = False,
    say: Say | None = None,
) -> Diagnosis:
    """Show what the model gets wrong about measured data, and name the cause.

    One stage after the other, each from one value to the next: the readings with their stations placed; what is to be solved, of the
    rows that count, with the causes to try; the causes and patterns that were selected; their sizes; the causes as they are reported;
    the answer.

    Args:
        data: the measurements.
        machine: the machine.
        calibration: the model to be judged; the machine file's own if None.
        instrument: what read the data; None where the table's uncertainties or the repeats say how it scatters.
        empirical: whether what is left unexplained and belongs to the machine extends the calibration too, without a known cause
            (`twin.diagnosis.judgement.extend`).
        say: told what is being done and how far it is.

    Raises:
        InputError: data that cannot be a measurement of this machine.
    """
    tell = say or (lambda stage, part: None)
    errors = Calibration.default(machine) if calibration is None else calibration
    with threadpool_limits(limits=1, user_api="blas"):
        tell("placing the stations", 0.0)
        placed = readings(data, machine, errors, instrument)
        tell("searching", 0.2)
        question = diagnosis_task(placed)
        found = selected(question)
        tell("weighing", 0.7)
        causes = judged(sized(found), errors)
        return answer(causes, errors, empirical=empirical)
