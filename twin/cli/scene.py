"""Command ``twin scene``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twin._common.bundled import DEFAULT
from twin._common.provenance import warning_texts, warnings_to_json
from twin.cli.shared import options
from twin.cli.shared.command import HTML, POSITIVE, CommandResult, JsonOption, command, progress_bar

if TYPE_CHECKING:
    from twin.compensation.programs.execute import Execution
    from twin.model.calibration import Calibration

ExaggerationOption = Annotated[
    float | None,
    typer.Option("--exaggeration", help="Exaggeration factor of the drawn deviation; default: chosen to fit."),
    POSITIVE,
]


@command(
    "twin scene cone_frustum.nc -o scene.html --tool-length 120",
    "twin scene part.nc -o scene.html --calibration mine.yaml --exaggeration 500 --json scene.json",
)
def scene(
    program: options.ProgramArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="HTML file to write."), HTML],
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    mode: options.ModeOption = options.Mode.axis,
    language: options.LanguageOption = None,
    tool_length: options.ToolOption = None,
    work_offset: options.OffsetOption = None,
    work_origin: options.OriginOption = None,
    offsets: options.OffsetsOption = None,
    tools: options.ToolsOption = None,
    exaggeration: ExaggerationOption = None,
    temperature: options.TemperatureOption = None,
    time: options.TimeOption = None,
    rpm: options.RpmOption = None,
    load: options.LoadOption = None,
    json_file: JsonOption = None,
) -> CommandResult:
    """Animate the machine running a program, with programmed and actual tool path, in one self-contained HTML file."""
    from twin._common.bundled import find_program
    from twin.reporting.scene.draw import draw_program  # imports meshcat, which is slow and needed only here

    loaded = options.machine(machine)
    source = find_program(program)
    errors = options.calibration_of(calibration, loaded)
    at = options.conditions(temperature, time, rpm, load)
    with progress_bar() as bar:
        drawn = draw_program(
            source,
            loaded,
            errors,
            tool_length_mm=tool_length,
            tcp=mode is options.Mode.tcp,
            setup=options.setup(loaded, work_offset, work_origin, offsets, tools),
            conditions=at,
            exaggeration=exaggeration,
            language=language,
            progress=bar,
        )
    run = drawn.execution
    drawn.save(output)
    length = loaded.tool_length_mm if tool_length is None else tool_length
    omitted = f" (omitted: {run.omitted})" if run.omitted else ""
    return CommandResult(
        "".join(f"{text}\n" for text in warning_texts(errors.warnings)),
        lambda: _report(output, source, errors, length, run),
        met=run.complete,
        written=omitted,
        after=options.unused(at, errors),
    )


def _report(output: Path, source: Path, errors: Calibration, tool_length_mm: float, run: Execution) -> dict[str, Any]:
    import numpy as np

    distance = np.linalg.norm(run.reached_mm - run.meant_mm, axis=1) * 1e3
    return {
        "schema": "twin.scene/1",
        "scene": str(output),
        "program": str(source),
        "machine": errors.machine.name,
        "calibration": None if errors.path is None else str(errors.path),
        "illustrative": errors.illustrative,
        "warnings": warnings_to_json(errors.warnings),
        "tool_length_mm": tool_length_mm,
        "points": len(run.positions),
        "left_out": run.left_out,
        "unknown": [one._asdict() | {"line": one.line + 1} for one in run.unknown],
        "deviation_um": {"rms": float(np.sqrt(np.mean(distance**2))), "max": float(distance.max())},
        "largest_at_line": int(run.lines[int(np.argmax(distance))]),
    }
