"""Command ``twin diagnose``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError
from twin._common.families import Language
from twin.cli.shared import complete, options
from twin.cli.shared.command import CALIBRATION, HTML, CommandResult, JsonOption, command, progress_bar
from twin.cli.shared.paper import JobOption, LangOption, LogoOption, PdfOption, paper


@command(
    "twin diagnose measured.csv --calibration mine.yaml --html diagnosis.html",
    "twin diagnose first.csv second.csv -c mine.yaml --json diagnosis.json --extended better.yaml",
    "twin diagnose measured.csv -c mine.yaml --extended better.yaml --empirical",
)
def diagnose(
    measured: options.MeasuredArgument,
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    instrument: Annotated[
        str | None,
        typer.Option(
            "--instrument",
            help="Instrument whose noise model is used; default: the table's uncertainties, else the repeats.",
            autocompletion=complete.instruments,
        ),
    ] = None,
    json_file: JsonOption = None,
    html_file: Annotated[Path | None, typer.Option("--html", help="Write the report to this HTML file."), HTML] = None,
    pdf_file: PdfOption = None,
    job: JobOption = None,
    logo: LogoOption = None,
    lang: LangOption = Language.en,
    extended: Annotated[
        Path | None,
        typer.Option(
            "--extended", help="Write the calibration, extended by the causes found on the machine, to this file."
        ),
        CALIBRATION,
    ] = None,
    empirical: Annotated[
        bool,
        typer.Option(
            "--empirical",
            help="Add empirical terms for unexplained residuals if held-out data confirm them; valid in the measured range only.",
        ),
    ] = False,
) -> CommandResult:
    """Compare measurements with the calibrated model and name the causes of significant residuals."""
    from twin.diagnosis import diagnose as run_diagnosis
    from twin.measurement.instruments import instrument_named
    from twin.measurement.table import Measurements

    if empirical and extended is None:
        raise InputError("--empirical needs --extended", expected="--extended CALIBRATION.yaml as well")
    page = paper(html_file, pdf_file, job, logo, lang)
    loaded = options.machine(machine)
    errors = options.calibration_of(calibration, loaded)
    if extended is not None and errors.corrected_in_control and errors.control is not None:
        raise InputError(
            "a kinematics module in the control corrects these errors, and would not correct those that are added",
            expected=f"the calibration {errors.control.live[-1].file.name} for readings with the module switched off; for readings "
            "with it on, one that was identified with --control linuxcnc-kinematics",
            file=errors.path,
            setting="extended",
        )
    with progress_bar() as bar:
        bar("reading", 0.0)
        data = Measurements.join([Measurements.load(path, loaded) for path in measured])
        reader = None if instrument is None else instrument_named(instrument)
        diagnosis = run_diagnosis(data, loaded, errors, instrument=reader, empirical=empirical, progress=bar)
    if extended is not None:
        diagnosis.extended.save(extended)
    if page.wanted:
        from twin.diagnosis.page import diagnosis_html

        files = [*measured, *([] if errors.path is None else [errors.path])]
        page.write(lambda sheet: diagnosis_html(diagnosis, sheet), files)
    return CommandResult(diagnosis.to_text(), diagnosis.to_dict, met=not diagnosis.data.set_aside)
