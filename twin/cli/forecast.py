"""Command ``twin forecast``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin._common.bundled import DEFAULT
from twin.cli.shared import options
from twin.cli.shared.command import EXISTING, CommandResult, JsonOption, command, progress_bar


@command(
    "twin forecast part.nc --features part.yaml --tool-length 120",
    "twin forecast part.nc --features part.yaml --calibration mine.yaml --json forecast.json",
)
def forecast(
    program: options.ProgramArgument,
    features: Annotated[
        Path, typer.Option("--features", help="Features, tolerances and tools of the part (.yaml)."), EXISTING
    ],
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    mode: options.ModeOption = options.Mode.axis,
    language: options.LanguageOption = None,
    tool_length: options.ToolOption = None,
    work_offset: options.OffsetOption = None,
    work_origin: options.OriginOption = None,
    offsets: options.OffsetsOption = None,
    tools: options.ToolsOption = None,
    temperature: options.TemperatureOption = None,
    time: options.TimeOption = None,
    rpm: options.RpmOption = None,
    load: options.LoadOption = None,
    machines: Annotated[int, typer.Option("--machines", help="Number of machines drawn.", min=100, max=100_000)] = 1000,
    json_file: JsonOption = None,
) -> CommandResult:
    """Forecast which tolerances of a part a program holds on this machine, as it is and compensated.

    The exit status is 3 unless every tolerance is held by one of the two with a probability of at least 95 %.
    """
    from twin.compensation.programs.prepared import Options
    from twin.nc import read_program
    from twin.part.features import PartDrawing
    from twin.part.forecast import forecast as run

    loaded = options.machine(machine)
    errors = options.calibration_of(calibration, loaded)
    part = PartDrawing(features)
    with progress_bar() as bar:
        found = run(
            part,
            read_program(program, language),
            loaded,
            errors,
            Options(
                setup=options.setup(loaded, work_offset, work_origin, offsets, tools),
                tool_length_mm=tool_length,
                tcp=mode is options.Mode.tcp,
                conditions=options.conditions(temperature, time, rpm, load),
            ),
            machines=machines,
            progress=bar,
        )
    return CommandResult(found.to_text(), found.to_dict, met=found.met)
