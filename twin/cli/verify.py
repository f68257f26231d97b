"""Command ``twin verify``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twin._common.bundled import DEFAULT, DEFAULT_ROTARY_LIMIT_DEG
from twin.cli.shared import complete, options
from twin.cli.shared.command import POSITIVE, PROGRAM, CommandResult, JsonOption, command


class Control(StrEnum):
    """Control that executes the program."""

    linuxcnc = "linuxcnc"


@command(
    "twin verify cone_frustum.nc --control linuxcnc --tool-length 120",
    "twin verify part.ngc --control linuxcnc --calibration mine.yaml --offsets linuxcnc.var --tools tool.tbl --json verified.json",
)
def verify(
    program: Annotated[
        Path,
        typer.Argument(
            metavar="PROGRAM",
            help="NC program of LinuxCNC, or the name of a bundled one.",
            autocompletion=complete.programs,
        ),
        PROGRAM,
    ],
    control: Annotated[Control, typer.Option("--control", help="Control that executes the program.")],
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    tool_length: options.ToolOption = None,
    work_offset: options.OffsetOption = None,
    offsets: options.OffsetsOption = None,
    tools: options.ToolsOption = None,
    rotary_limit: options.RotaryLimitOption = DEFAULT_ROTARY_LIMIT_DEG,
    temperature: options.TemperatureOption = None,
    time: options.TimeOption = None,
    rpm: options.RpmOption = None,
    load: options.LoadOption = None,
    tolerance: Annotated[
        float | None, typer.Option("--tolerance", help="Largest permitted error over the motion, mm."), POSITIVE
    ] = None,
    acceleration: Annotated[
        float, typer.Option("--acceleration", help="Acceleration of the control's axes, mm/s² and °/s²."), POSITIVE
    ] = 5000.0,
    user: Annotated[
        str, typer.Option("--user", help="User who runs the control, if twin runs as root; the control refuses root.")
    ] = "",
    json_file: JsonOption = None,
) -> CommandResult:
    """Let a control on this computer execute a program and its compensated form, and evaluate the error over the whole motion.

    LinuxCNC runs without a display, in real time: as long as the program runs on the machine, three times (original, compensated, and
    with G61). The positions of its motors are sampled every millisecond; the report says what remains at the tool, where, and how much
    of it is the control's own path.
    """
    from twin._common.bundled import find_program
    from twin.compensation import Compensator, Options
    from twin.compensation.verification import verify as verified

    loaded = options.machine(machine)
    settings = Options(
        setup=options.setup(loaded, work_offset, None, offsets, tools),
        tool_length_mm=tool_length,
        rotary_limit_deg=rotary_limit,
        conditions=options.conditions(temperature, time, rpm, load),
    )
    compensator = Compensator(loaded, options.calibration_of(calibration, loaded), settings)
    found = verified(find_program(program), compensator, user=user, acceleration=acceleration)
    met = tolerance is None or found.after.largest_um <= 1e3 * tolerance
    return CommandResult(found.to_text(), found.to_dict, met=met)
