"""Command ``twin report``."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from twin._common.bundled import DEFAULT
from twin._common.families import Language
from twin._common.files import write_atomic
from twin._common.provenance import warning_texts
from twin.cli.shared import options
from twin.cli.shared.command import HTML, XML, CommandResult, JsonOption, Output, command, progress_bar
from twin.cli.shared.terminal import tolerances

if TYPE_CHECKING:
    from twin.machine.machine import Machine
    from twin.reporting import MachineReport
    from twin.reporting.front import FrontPage, Job

SHOWN: Final = 8
"""Number of items out of tolerance that are printed."""
JobOption = Annotated[
    Path | None,
    typer.Option(
        "--job",
        help="YAML file (schema: twin.job/1) of the first page: machine, serial_number, operator, customer, place, date, "
        "instrument, instrument_serial, certificate, temperature; all optional text; dcc: facts of a certificate.",
    ),
]
DccOption = Annotated[
    Path | None,
    typer.Option(
        "--dcc",
        help="Also write a digital calibration certificate (DCC 3.1.2, XML) to this file; its facts come from --job "
        "(twin doc certificates). It is not signed.",
    ),
    XML,
]
UNSIGNED = "the certificate is not signed: a file is no signature"
FrontToleranceOption = Annotated[
    list[str] | None,
    typer.Option(
        "--tolerance",
        help="Largest permitted absolute value, µm or µrad, of an error or of the tool point over the volume: "
        "before (tool) or after compensation (tool_after): tool=50 E_XX=8.",
    ),
]
LangOption = Annotated[Language, typer.Option("--lang", help="Language of the report.")]
PdfOption = Annotated[
    Path | None,
    typer.Option("--pdf", help="Also print to this PDF file, through Chromium, Chrome or Edge (or TWIN_BROWSER)."),
    Output((".pdf",)),
]
LogoOption = Annotated[
    Path | None, typer.Option("--logo", help="PNG or SVG picture for the first page, up to 512 KiB.")
]
IdentifiedOption = Annotated[
    Path | None, typer.Option("--identified", help="JSON file of `twin identify --json` for this calibration.")
]
ComparedOption = Annotated[
    list[Path] | None, typer.Option("--measured", help="Measurement table to compare with the calibration; repeatable.")
]


@command(
    "twin report -o machine.html --calibration mine.yaml --tool-length 120",
    "twin report -o machine.html -c mine.yaml --identified identified.json --measured measured.csv --json machine.json",
    "twin report -o signed.html -c mine.yaml --job job.yaml --logo shop.png --tolerance tool=50 E_XX=8 --lang de --pdf signed.pdf",
    "twin report -o machine.html -c mine.yaml --job job.yaml --dcc machine.xml",
    "twin report -o warm.html -c better.yaml --temperature X=23.1 bed=21 --time 7200",
)
def report(
    output: Annotated[Path, typer.Option("--output", "-o", help="HTML file to write, for screen and paper."), HTML],
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    tool_length: options.ToolOption = None,
    identified: IdentifiedOption = None,
    measured: ComparedOption = None,
    temperature: options.TemperatureOption = None,
    time: options.TimeOption = None,
    rpm: options.RpmOption = None,
    load: options.LoadOption = None,
    job: JobOption = None,
    logo: LogoOption = None,
    tolerance: FrontToleranceOption = None,
    lang: LangOption = Language.en,
    pdf_file: PdfOption = None,
    dcc_file: DccOption = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Random seed of the Monte Carlo draws.")] = 0,
    json_file: JsonOption = None,
) -> CommandResult:
    """Write a report of a machine: largest errors, their effect at the tool, recommended actions, uncertainty and sources.

    The exit status is 3 if a value exceeds its tolerance or is unknown, or if something asked for could not be shown.
    """
    from twin.measurement.table import Measurements
    from twin.reporting import machine_report
    from twin.reporting.certificate import calibration_certificate
    from twin.reporting.front import front_page
    from twin.reporting.page import find_browser, page_to_pdf

    options.need_pictures("the report")
    loaded = options.machine(machine)
    limits, facts, picture = _of_first_page(loaded, tolerance or [], job, logo)
    browser = None if pdf_file is None else find_browser()
    errors = options.calibration_of(calibration, loaded)
    certificate = None if dcc_file is None else calibration_certificate(errors, facts, job)
    at = options.conditions(temperature, time, rpm, load)
    with progress_bar() as bar:
        bar("reading", 0.0)
        machine_page = machine_report(
            loaded,
            errors,
            made=datetime.now().astimezone(),
            tool_length_mm=tool_length,
            conditions=at,
            identified=identified,
            measured=[(path, Measurements.load(path, loaded)) for path in measured or []],
            seed=seed,
            progress=lambda stage, part: bar(stage, 0.5 * part),
        )
        from twin.reporting.page import machine_html  # imports matplotlib and meshcat: slow, and needed only here

        bar("drawing", 0.5)
        front = front_page(machine_page, facts, limits, picture)
        page = machine_html(machine_page, front, lang)
        printed = None if browser is None else page_to_pdf(page, browser)
    write_atomic(output, page)
    if pdf_file is not None and printed is not None:
        write_atomic(pdf_file, printed)
    if dcc_file is not None and certificate is not None:
        write_atomic(dcc_file, certificate)
    unsigned = [] if dcc_file is None else [UNSIGNED]
    return _result(machine_page, front, [*options.unused(at, errors), *unsigned])


def _of_first_page(
    machine: Machine, tolerance: list[str], job: Path | None, logo: Path | None
) -> tuple[dict[str, float], Job | None, str]:
    """Return tolerances by item, facts of the test and the logo."""
    from twin.reporting.front import check_tolerances, load_job, logo_uri

    limits = tolerances(tolerance)
    check_tolerances(machine, limits)
    return limits, None if job is None else load_job(job), "" if logo is None else logo_uri(logo)


def _result(found: MachineReport, front: FrontPage, unused: Iterable[str]) -> CommandResult:
    verdict, counts = front.verdict, [f"{front.count(k)} {k}" for k in ("fail", "undecided", "pass") if front.count(k)]
    judged = [] if verdict is None else [f"tolerances (ISO 14253-1): {verdict.upper()}; items: {', '.join(counts)}"]
    items = front.not_accepted
    more = [f"and {len(items) - SHOWN} further items, all in the JSON"] if len(items) > SHOWN else []
    return CommandResult(
        "\n".join([*_first_screen(found), *judged, *unused, ""]),
        lambda: found.to_dict() | {"first_page": front.to_dict()},
        met=not found.unmet and not front.not_accepted,
        after=[f"not met: {text}" for text in (*found.unmet, *(item.text for item in items[:SHOWN]), *more)],
    )


def _first_screen(found: MachineReport) -> list[str]:
    names = {"do": "do", "measure": "measure", "never": "do not", "unknown": "not known"}
    return [
        *([*warning_texts(found.warnings), ""] if found.warnings else []),
        found.advice.headline,
        *(f"  {line}" for line in found.advice.largest_errors),
        *(f"{names[step.kind]}: {step.title}. {step.text}" for step in found.advice.steps),
        found.datum,
    ]
