"""Commands ``twin compare`` and ``twin watch``: what changed on a machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin._common.bundled import DEFAULT
from twin._common.families import Language
from twin._common.files import folder_entries, write_atomic
from twin.cli.shared import complete, options
from twin.cli.shared.command import EXISTING, HTML, POSITIVE, CommandResult, JsonOption, command, progress_bar
from twin.cli.shared.paper import JobOption, LangOption, LogoOption, PdfOption, paper
from twin.cli.shared.terminal import pairs


@command(
    "twin compare last_year.yaml this_year.yaml --tool-length 120",
    "twin compare before.yaml after.yaml --tolerance 0.01 --json changes.json --html changes.html",
)
def compare(
    first: Annotated[
        Path, typer.Argument(metavar="OLDER", help="Older calibration.", autocompletion=complete.calibrations), EXISTING
    ],
    second: Annotated[
        Path,
        typer.Argument(
            metavar="NEWER", help="Newer calibration of the same machine.", autocompletion=complete.calibrations
        ),
        EXISTING,
    ],
    machine: options.MachineOption = DEFAULT,
    tool_length: options.ToolOption = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            "--tolerance",
            help="Largest permitted error at the tool, mm, if programs are still compensated with the older calibration.",
        ),
        POSITIVE,
    ] = None,
    temperature: options.TemperatureOption = None,
    time: options.TimeOption = None,
    rpm: options.RpmOption = None,
    load: options.LoadOption = None,
    json_file: JsonOption = None,
    html_file: Annotated[Path | None, typer.Option("--html", help="Write the changes to this HTML file."), HTML] = None,
    pdf_file: PdfOption = None,
    job: JobOption = None,
    logo: LogoOption = None,
    lang: LangOption = Language.en,
) -> CommandResult:
    """Compare two calibrations of a machine: changes, their significance, and their effect at the tool.

    The exit status is 0 whether or not anything changed, and 3 if an error could not be compared (only one calibration gives it, or one
    gives no uncertainty), or if the older calibration is proven not to meet the tolerance.
    """
    from twin.model.calibration import Calibration
    from twin.monitoring import compare as compared

    page = paper(html_file, pdf_file, job, logo, lang, drawn=False)
    loaded = options.machine(machine)
    older, newer = (Calibration.load(path, loaded) for path in (first, second))
    with progress_bar() as bar:
        comparison = compared(
            older,
            newer,
            tool_length_mm=tool_length,
            conditions=options.conditions(temperature, time, rpm, load),
            tolerance_mm=tolerance,
            progress=bar,
        )
    page.write(comparison.to_html, [first, second])
    return CommandResult(
        comparison.to_text(), comparison.to_dict, met=not comparison.unjudged and comparison.good_enough is not False
    )


@command(
    "twin watch checks --calibration mine.yaml --tolerance 0.02 --html watch.html",
    "twin watch checks --since 2026-05-04 --alarm-rate 0.01 --json watch.json",
    "twin watch checks --date first.csv=2026-03-02 --date second.csv=2026-03-05T08:10",
)
def watch(
    folder: Annotated[Path, typer.Argument(help="Folder of measurement tables (.csv), one for each check.")],
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    tolerance: Annotated[
        float | None,
        typer.Option("--tolerance", help="Largest permitted error at the tool, mm, with this calibration."),
        POSITIVE,
    ] = None,
    alarm_rate: Annotated[
        float,
        typer.Option(
            "--alarm-rate", help="Probability of any alarm for an unchanged machine, whatever the number of looks."
        ),
    ] = 0.05,
    tool_length: options.ToolOption = None,
    since: Annotated[
        str | None,
        typer.Option("--since", help="Date before which checks are not used, ISO 8601: after a repair; default: all."),
    ] = None,
    date: Annotated[
        list[str] | None,
        typer.Option("--date", help="FILE=DATE of a check whose table and name give no date, ISO 8601; repeatable."),
    ] = None,
    json_file: JsonOption = None,
    html_file: Annotated[Path | None, typer.Option("--html", help="Write the history to this HTML file."), HTML] = None,
) -> CommandResult:
    """Watch a folder of check measurements: which error changed, since when, is it temperature, is the calibration still good.

    Records of a control with live compensation in the folder give temperatures, and say whether the correction was on.
    FOLDER.watch.sqlite beside the folder remembers what was read and said. The exit status is 3 if an error changed, or if the
    calibration is proven not to meet the tolerance.
    """
    folder_entries(folder, "the folder of checks")
    from twin.monitoring import WatchSettings
    from twin.monitoring import watch as run_watch
    from twin.monitoring.check import parsed_date
    from twin.monitoring.watch_page import news_text

    if html_file is not None:
        options.need_pictures("the HTML page")
    words = pairs("--date", date or [], "FILE=DATE: first.csv=2026-03-02", last=True)
    settings = WatchSettings(
        alarm_rate=alarm_rate,
        tolerance_mm=tolerance,
        tool_length_mm=tool_length,
        dates={name: parsed_date(text) for name, text, _ in words},
        since=None if since is None else parsed_date(since),
    )
    loaded = options.machine(machine)
    errors = options.calibration_of(calibration, loaded)
    with progress_bar() as bar:
        watched = run_watch(folder, loaded, errors, settings=settings, progress=bar)
    if html_file is not None:
        from twin.monitoring.watch_page import watch_html  # imports matplotlib, which is slow and needed only here

        write_atomic(html_file, watch_html(watched))
    return CommandResult(watched.to_text() + news_text(watched), watched.to_dict, met=watched.met)
