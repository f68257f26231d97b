"""``twin compare``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.cli.shared import complete, options
from twin.cli.shared.command import POSITIVE, CommandResult, JsonOption, command, progress
from twin.comparison import compare as compared
from twin.comparison import text_of
from twin.machine.calibration import Calibration
from twin.machine.machine import DEFAULT, Machine


@command(
    "twin compare last_year.yaml this_year.yaml --tool-length 120",
    "twin compare before.yaml after.yaml --tolerance 0.01 --json changes.json",
)
def compare(
    first: Annotated[
        Path, typer.Argument(metavar="OLDER", help="The older calibration.", autocompletion=complete.calibrations)
    ],
    second: Annotated[
        Path,
        typer.Argument(
            metavar="NEWER", help="The newer calibration of the same machine.", autocompletion=complete.calibrations
        ),
    ],
    machine: options.MachineOption = DEFAULT,
    tool_length: options.ToolOption = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            "--tolerance", help="mm the older calibration may leave on the machine as the newer describes it."
        ),
        POSITIVE,
    ] = None,
    temperature: options.TemperatureOption = None,
    time: options.TimeOption = None,
    json_file: JsonOption = None,
) -> CommandResult:
    """What changed between two calibrations of one machine, what of it is significant, and what it means at the tool.

    The exit status is 0 whether anything changed or not, and 3 if an error could not be compared or judged: only one of the two gives
    it, or one does not say how uncertain it is.
    """
    loaded = Machine.load(machine)
    older, newer = (Calibration.load(path, loaded) for path in (first, second))
    with progress() as say:
        found = compared(
            older,
            newer,
            tool_length_mm=tool_length,
            conditions=options.conditions(temperature, time),
            tolerance_mm=tolerance,
            progress=say,
        )
    return CommandResult(text_of(found), found.to_dict, met=not found.unjudged)
