"""Command ``twin compare``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin._common.bundled import DEFAULT
from twin.cli.shared import complete, options
from twin.cli.shared.command import EXISTING, POSITIVE, CommandResult, JsonOption, command, progress_bar


@command(
    "twin compare last_year.yaml this_year.yaml --tool-length 120",
    "twin compare before.yaml after.yaml --tolerance 0.01 --json changes.json",
)
def compare(
    first: Annotated[
        Path,
        typer.Argument(metavar="OLDER", help="Older calibration.", autocompletion=complete.calibrations),
        EXISTING,
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
) -> CommandResult:
    """Compare two calibrations of a machine: changes, their significance, and their effect at the tool.

    The exit status is 0 whether or not anything changed, and 3 if an error could not be compared (only one calibration gives it, or one
    gives no uncertainty), or if the older calibration is proven not to meet the tolerance.
    """
    from twin.model.calibration import Calibration
    from twin.monitoring import compare as compared

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
    return CommandResult(
        comparison.to_text(), comparison.to_dict, met=not comparison.unjudged and comparison.good_enough is not False
    )
