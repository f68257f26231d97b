"""Command ``twin evaluate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError
from twin._common.families import Language
from twin._common.files import write_atomic
from twin.cli.shared import complete, options
from twin.cli.shared.command import HTML, POSITIVE, CommandResult, JsonOption, Output, command
from twin.cli.shared.paper import UNSIGNED, DccOption, JobOption, LangOption, LogoOption, PdfOption, paper
from twin.cli.shared.terminal import tolerances

if TYPE_CHECKING:
    from twin.machine.machine import Machine
    from twin.measurement.instruments import Instrument
    from twin.model.calibration import Calibration
    from twin.standards import EvaluationResult

ToleranceOption = Annotated[
    list[str] | None,
    typer.Option(
        "--tolerance",
        help="Largest permitted value, µm or µrad, by symbol, or by axis and symbol: A=10 B=3 X:A=8 H=5; see twin doc evaluate.",
    ),
]
InstrumentOption = Annotated[
    str | None,
    typer.Option(
        "--instrument",
        help="Instrument whose noise model gives the uncertainty of readings; default: the table's uncertainties, else unknown.",
        autocompletion=complete.instruments,
    ),
]
LengthOption = Annotated[
    float | None,
    typer.Option(
        "--length",
        help="Nominal length of the ball bar, mm; default: that of the table's comment, else the radius of the commanded circle.",
    ),
    POSITIVE,
]
DriftOption = Annotated[
    bool, typer.Option("--iso230-3", help="Evaluate the thermal tests of ISO 230-3: displacements over time_s.")
]
SensorsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--sensors",
        help="Directions and distances of sensors, with --iso230-3: d1=X1 d2=X2 X1-X2=76 t5=ambient; default: the table's.",
    ),
]

CalibrationOutput = Annotated[
    Path | None,
    typer.Option(
        "--output", "-o", help="Calibration to write, with the scales and squarenesses that the sheets determine."
    ),
    Output((".yaml", ".yml")),
]


@command(
    "twin evaluate measured.csv --html tests.html --json tests.json",
    "twin evaluate measured.csv --tolerance A=10 B=3 H=5",
    "twin evaluate measured.csv --tolerance A=10 --job job.yaml --lang de --pdf certificate.pdf",
    "twin evaluate measured.csv --tolerance X:A=8 Y:A=12 E_C0Y=20 --instrument tracker",
    "twin evaluate measured.csv --instrument tracker --job job.yaml --dcc iso230_2.xml",
    "twin evaluate record.csv --iso230-3 --sensors d1=X1 d2=X2 X1-X2=76 d5=Z t5=ambient --html drift.html",
    "twin evaluate diagonals.csv square.csv -m router.yaml -o mine.yaml",
)
def evaluate(
    measured: options.MeasuredArgument,
    machine: options.MachineOption = DEFAULT,
    tolerance: ToleranceOption = None,
    instrument: InstrumentOption = None,
    length: LengthOption = None,
    drift: DriftOption = False,
    sensors: SensorsOption = None,
    job: JobOption = None,
    dcc_file: DccOption = None,
    json_file: JsonOption = None,
    html_file: Annotated[Path | None, typer.Option("--html", help="Write the report to this HTML file."), HTML] = None,
    output: CalibrationOutput = None,
    pdf_file: PdfOption = None,
    logo: LogoOption = None,
    lang: LangOption = Language.en,
) -> CommandResult:
    """Evaluate the standard tests for which a measurement table has the runs, or the sheets of artefacts.

    The exit status is 3 if a tolerance is not met, if no test gives its value, or if the table allows no test at all.
    """
    from twin.measurement.instruments import instrument_named
    from twin.measurement.table import Measurements
    from twin.standards import evaluate as run_evaluation
    from twin.standards.artefacts import is_sheet

    limits = tolerances(tolerance or [])
    page = paper(html_file, pdf_file, job, logo, lang)
    loaded = options.machine(machine)
    reader = None if instrument is None else instrument_named(instrument)
    calibration = None
    if any(map(is_sheet, measured)):
        if drift or sensors or reader is not None or length is not None:
            raise InputError(
                "a sheet states its own instrument", expected="sheets with --tolerance, --html, --json, -o"
            )
        evaluation, calibration = _sheets(measured, loaded, limits, wanted=output is not None)
    elif output is not None:
        raise InputError(
            "-o writes the calibration of artefacts", expected="sheets of twin plan --artefact", value=output
        )
    elif drift or sensors:
        evaluation = _drift(measured, loaded, limits, reader, length, sensors or [], drift)
    else:
        data = Measurements.join([Measurements.load(path, loaded) for path in measured])
        evaluation = run_evaluation(data, loaded, tolerances=limits, instrument=reader, length_mm=length)
    certificate = None
    if dcc_file is not None:
        from twin.reporting.certificate import evaluation_certificate

        certificate = evaluation_certificate(evaluation, page.job, job)
    elif job is not None and not page.wanted:
        raise InputError("--job without a page", expected="--html, --pdf or --dcc, for which the job's facts are")
    if page.wanted:
        from twin.standards.page import evaluation_html  # imports matplotlib, which is slow and needed only here

        page.write(lambda sheet: evaluation_html(evaluation, sheet), [*measured, loaded.path])
    after = [] if reader is not None else _advice(evaluation)
    if dcc_file is not None and certificate is not None:
        write_atomic(dcc_file, certificate)
        after.append(UNSIGNED)
    if output is not None and calibration is not None:
        calibration.save(output)
        after += [f"For the control: twin control --to FORMAT -m {machine} -c {output} -o FOLDER"]
    met = evaluation.met and bool(evaluation.tests)
    return CommandResult(evaluation.to_text(), evaluation.to_dict, met=met, after=after)


def _advice(evaluation: EvaluationResult) -> list[str]:
    """Return what to do where values have no uncertainty, if any has none."""
    unknown = any(one.u != one.u for test in evaluation.tests for one in test.values)
    return ["No uncertainty for some values: name the instrument with --instrument (twin doc instruments)"] * unknown


def _drift(
    measured: list[Path],
    machine: Machine,
    limits: dict[str, float],
    reader: Instrument | None,
    length: float | None,
    sensors: list[str],
    drift: bool,
) -> EvaluationResult:
    """Evaluate the thermal tests of one record."""
    from twin.standards import evaluate_drift

    if not drift:
        raise InputError(
            "--sensors needs --iso230-3", expected="directions of displacement sensors", value=" ".join(sensors)
        )
    if len(measured) > 1 or length is not None:
        raise InputError("--iso230-3 evaluates one record", expected="one file, without --length")
    return evaluate_drift(measured[0], machine, tolerances=limits, instrument=reader, sensors=sensors)


def _sheets(
    paths: list[Path], machine: Machine, limits: dict[str, float], *, wanted: bool
) -> tuple[EvaluationResult, Calibration | None]:
    """Evaluate the sheets of artefacts; return the result, and its calibration if wanted."""
    from twin.standards.artefacts import calibration_of, evaluate_sheets, is_sheet

    other = next((path for path in paths if not is_sheet(path)), None)
    if other is not None:
        raise InputError(
            "a file that is not the sheet of an artefact, beside one",
            expected="sheets only, or tables only",
            value=other,
        )
    evaluation, found = evaluate_sheets(paths, machine, tolerances=limits)
    return evaluation, calibration_of(evaluation, found, machine) if wanted else None
