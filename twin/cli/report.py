"""Command ``twin report``."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError
from twin._common.families import Language
from twin._common.files import write_atomic
from twin._common.messages import Message, joined
from twin._common.provenance import warning_texts
from twin.cli.shared import options
from twin.cli.shared.command import HTML, CommandResult, JsonOption, command, progress_bar
from twin.cli.shared.complete import one_of
from twin.cli.shared.paper import UNSIGNED, DccOption, JobOption, LangOption, LogoOption, PdfOption, paper
from twin.cli.shared.terminal import tolerances

if TYPE_CHECKING:
    from twin._common.distributions import Verdict
    from twin.display.sheet import Sheet
    from twin.reporting.front import FrontPage
    from twin.reporting.result import MachineReport

WORDS: Final[dict[Verdict, Message]] = {
    "fail": Message("fail"),
    "undecided": Message("undecided"),
    "pass": Message("pass"),
}
KINDS: Final = {
    "do": Message("do"),
    "measure": Message("measure"),
    "never": Message("do not"),
    "unknown": Message("not known"),
}
SHOWN: Final = 8
"""Number of items out of tolerance that are printed."""
FrontToleranceOption = Annotated[
    list[str] | None,
    typer.Option(
        "--tolerance",
        help="Largest permitted absolute value, µm or µrad, of an error or of the tool point over the volume: "
        "before (tool) or after compensation (tool_after): tool=50 E_XX=8.",
    ),
]
IdentifiedOption = Annotated[
    Path | None, typer.Option("--identified", help="JSON file of `twin identify --json` for this calibration.")
]
KinematicsOption = Annotated[
    str | None,
    typer.Option(
        "--kinematics",
        help="Format of the control's kinematics: what it holds now and should hold, in its own names.",
        **one_of("kinematics_formats"),
    ),
]
PresentOption = Annotated[
    Path | None,
    typer.Option(
        "--present", help="File of the control with its present kinematics; default: the machine file's geometry."
    ),
]
HistoryOption = Annotated[
    list[Path] | None,
    typer.Option("--history", help="JSON of an earlier report of the machine, for the trend; repeatable."),
]
ComparedOption = Annotated[
    list[Path] | None, typer.Option("--measured", help="Measurement table to compare with the calibration; repeatable.")
]


@command(
    "twin report -o machine.html --calibration mine.yaml --tool-length 120",
    "twin report -o machine.html -c mine.yaml --identified identified.json --measured measured.csv --json machine.json",
    "twin report -o signed.html -c mine.yaml --job job.yaml --tolerance tool=50 E_XX=8 --lang de --pdf signed.pdf",
    "twin report -o machine.html -c mine.yaml --kinematics siemens-trafo5 --present trafo5.mpf --history last_year.json",
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
    kinematics: KinematicsOption = None,
    present: PresentOption = None,
    history: HistoryOption = None,
    lang: LangOption = Language.en,
    pdf_file: PdfOption = None,
    dcc_file: DccOption = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Random seed of the Monte Carlo draws.")] = 0,
    json_file: JsonOption = None,
) -> CommandResult:
    """Write a report of a machine: error at the tool before and after, verdict, actions, what the control should hold, and the details.

    The exit status is 3 if a value exceeds its tolerance or is unknown, or if something asked for could not be shown.
    """
    from twin.measurement.table import Measurements
    from twin.reporting.certificate import calibration_certificate
    from twin.reporting.front import check_tolerances, earlier_report, front_page
    from twin.reporting.result import machine_report

    page = paper(output, pdf_file, job, logo, lang)
    loaded = options.machine(machine)
    limits = tolerances(tolerance or [])
    check_tolerances(loaded, limits)
    if present is not None and kinematics is None:
        raise InputError("--present needs --kinematics", expected="the format of the file", value=present)
    earlier = [earlier_report(path, loaded) for path in history or []]
    errors = options.calibration_of(calibration, loaded)
    certificate = None if dcc_file is None else calibration_certificate(errors, page.job, job)
    at = options.conditions(temperature, time, rpm, load)
    with progress_bar() as bar:
        bar("reading", 0.0)
        found = machine_report(
            loaded,
            errors,
            made=datetime.now().astimezone(),
            tool_length_mm=tool_length,
            conditions=at,
            identified=identified,
            measured=[(path, Measurements.load(path, loaded)) for path in measured or []],
            kinematics=kinematics,
            present=present,
            seed=seed,
            progress=lambda stage, part: bar(stage, 0.5 * part),
        )
        # It imports matplotlib and meshcat: slow, and needed only here.
        from twin.reporting.page import machine_html, sheet_of

        bar("drawing", 0.5)
        front = front_page(found, limits, earlier)
        sheet = sheet_of(found, page.job, lang, page.logo)
        page.put(machine_html(found, front, sheet))
    if dcc_file is not None and certificate is not None:
        write_atomic(dcc_file, certificate)
    unsigned = [] if dcc_file is None else [UNSIGNED]
    return _result(found, front, sheet, [*options.unused(at, errors), *unsigned])


def _result(found: MachineReport, front: FrontPage, sheet: Sheet, unused: Iterable[str]) -> CommandResult:
    from twin.reporting.front import JUDGED

    judged = []
    if front.verdict is not None:
        counts = [Message("{count} {word}", count=front.count(k), word=WORDS[k]) for k in WORDS if front.count(k)]
        judged = [
            Message(
                "tolerances (ISO 14253-1): {verdict}; items: {counts}",
                verdict=JUDGED[front.verdict],
                counts=joined(", ", counts),
            )
        ]
    items = front.not_accepted
    more = (
        [Message("and {count} further items, all in the JSON", count=len(items) - SHOWN)] if len(items) > SHOWN else []
    )
    return CommandResult(
        joined("\n", [*_first_screen(found), *judged, *unused, ""]),
        lambda: found.to_dict() | {"first_page": sheet.to_dict() | front.to_dict()},
        met=not found.unmet and not front.not_accepted,
        after=[
            Message("not met: {text}", text=text)
            for text in (*found.unmet, *(item.text for item in items[:SHOWN]), *more)
        ],
    )


def _first_screen(found: MachineReport) -> list[str]:
    advice = found.advice
    steps = [Message("{kind}: {title}. {text}", kind=KINDS[s.kind], title=s.title, text=s.text) for s in advice.steps]
    return [
        *([*warning_texts(found.warnings), ""] if found.warnings else []),
        advice.headline,
        *(joined("", ["  ", line]) for line in advice.largest_errors),
        *steps,
        found.datum,
    ]
