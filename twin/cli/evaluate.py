"""Command ``twin evaluate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError
from twin._common.families import Language
from twin.cli.shared import complete, options
from twin.cli.shared.command import HTML, POSITIVE, CommandResult, JsonOption, command
from twin.cli.shared.paper import JobOption, LangOption, LogoOption, PdfOption, paper
from twin.cli.shared.terminal import tolerances

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


@command(
    "twin evaluate measured.csv --html tests.html --json tests.json",
    "twin evaluate measured.csv --tolerance A=10 B=3 H=5",
    "twin evaluate measured.csv --tolerance A=10 --job job.yaml --lang de --pdf certificate.pdf",
    "twin evaluate measured.csv --tolerance X:A=8 Y:A=12 E_C0Y=20 --instrument tracker",
    "twin evaluate record.csv --iso230-3 --sensors d1=X1 d2=X2 X1-X2=76 d5=Z t5=ambient --html drift.html",
)
def evaluate(
    measured: options.MeasuredArgument,
    machine: options.MachineOption = DEFAULT,
    tolerance: ToleranceOption = None,
    instrument: InstrumentOption = None,
    length: LengthOption = None,
    drift: DriftOption = False,
    sensors: SensorsOption = None,
    json_file: JsonOption = None,
    html_file: Annotated[Path | None, typer.Option("--html", help="Write the report to this HTML file."), HTML] = None,
    pdf_file: PdfOption = None,
    job: JobOption = None,
    logo: LogoOption = None,
    lang: LangOption = Language.en,
) -> CommandResult:
    """Evaluate the standard tests for which a measurement table has the runs.

    The exit status is 3 if a tolerance is not met, if no test gives its value, or if the table allows no test at all.
    """
    from twin.measurement.instruments import instrument_named
    from twin.measurement.table import Measurements
    from twin.standards import evaluate as run_evaluation
    from twin.standards import evaluate_drift

    limits = tolerances(tolerance or [])
    page = paper(html_file, pdf_file, job, logo, lang)
    loaded = options.machine(machine)
    reader = None if instrument is None else instrument_named(instrument)
    if drift:
        if len(measured) > 1 or length is not None:
            raise InputError("--iso230-3 evaluates one record", expected="one file, without --length")
        evaluation = evaluate_drift(measured[0], loaded, tolerances=limits, instrument=reader, sensors=sensors or [])
    elif sensors:
        raise InputError(
            "--sensors needs --iso230-3", expected="directions of displacement sensors", value=" ".join(sensors)
        )
    else:
        data = Measurements.join([Measurements.load(path, loaded) for path in measured])
        evaluation = run_evaluation(data, loaded, tolerances=limits, instrument=reader, length_mm=length)
    if page.wanted:
        from twin.standards.page import evaluation_html  # imports matplotlib, which is slow and needed only here

        page.write(lambda sheet: evaluation_html(evaluation, sheet), [*measured, loaded.path])
    return CommandResult(evaluation.to_text(), evaluation.to_dict, met=evaluation.met and bool(evaluation.tests))
