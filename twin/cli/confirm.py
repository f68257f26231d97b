"""Command ``twin confirm``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError
from twin._common.files import write_atomic
from twin.cli.shared import complete, options
from twin.cli.shared.command import EXISTING, HTML, CommandResult, JsonOption, command, progress_bar
from twin.cli.shared.terminal import number, pairs


@command(
    "twin confirm before.csv after.csv --written tables --tool-length 120",
    "twin confirm mine.yaml check.csv --written tables --json confirmed.json --html confirmed.html",
    "twin confirm before.csv after.csv --calibration mine.yaml --compensated",
    "twin confirm before.csv after.csv --calibration mine.yaml --adjusted E_C0Y=0",
    "twin confirm last_check.csv check.csv",
)
def confirm(
    before: Annotated[
        Path,
        typer.Argument(
            metavar="BEFORE",
            help="Readings before (.csv), or the calibration of the machine before (.yaml).",
            autocompletion=complete.tables,
        ),
        EXISTING,
    ],
    after: Annotated[
        Path, typer.Argument(metavar="AFTER", help="Readings afterwards.", autocompletion=complete.tables), EXISTING
    ],
    machine: options.MachineOption = DEFAULT,
    calibration: Annotated[
        Path | None,
        typer.Option(
            "--calibration", "-c", help="Calibration of the machine before.", autocompletion=complete.calibrations
        ),
        EXISTING,
    ] = None,
    written: Annotated[
        Path | None,
        typer.Option("--written", help="Folder that twin control wrote: its tables and kinematics were put in."),
    ] = None,
    compensated: Annotated[
        bool, typer.Option("--compensated", help="AFTER was measured with a program compensated with the calibration.")
    ] = False,
    adjusted: Annotated[
        list[str] | None,
        typer.Option(
            "--adjusted", help="Squareness or location adjusted at the machine, and its new value: E_C0Y=0 (µrad, µm)."
        ),
    ] = None,
    tool_length: options.ToolOption = None,
    json_file: JsonOption = None,
    html_file: Annotated[Path | None, typer.Option("--html", help="Write the verdict to this HTML file."), HTML] = None,
) -> CommandResult:
    """Confirm that tables, kinematics, an adjustment or a compensated program took effect; or that a crash moved nothing.

    With none of --written, --compensated and --adjusted, it says what moved between BEFORE and AFTER, or that nothing moved the tool by
    more than so many µm. The exit status is 3 unless the verdict is that everything is confirmed, or that nothing moved.
    """
    from twin.measurement.table import Measurements
    from twin.model.calibration import Calibration
    from twin.monitoring.confirmation import confirm as run
    from twin.monitoring.written import WrittenValue, adjustment, program_words, written_by

    loaded = options.machine(machine)
    is_calibration = before.suffix.lower() in (".yaml", ".yml")
    folder = None if written is None else written / "calibration.yaml"
    given = [path for path in (before if is_calibration else None, folder, calibration) if path is not None]
    if calibration is not None and len(given) > 1:
        raise InputError(
            "two calibrations",
            expected="--calibration only with readings BEFORE, and without --written",
            value=calibration,
        )
    if written is not None and compensated:
        raise InputError("--written and --compensated exclude each other", expected="one of them", value=written)
    if (compensated or adjusted) and not given:
        raise InputError(
            "no calibration", expected="--calibration of the machine before, with --compensated and --adjusted"
        )
    errors = Calibration.load(folder or given[0], loaded) if given else None
    length = loaded.tool_length_mm if tool_length is None else tool_length
    values: list[WrittenValue] = []
    if written is not None and errors is not None:
        values += written_by(errors, length)
    if compensated and errors is not None:
        values += program_words(errors, length)
    for name, text, entry in pairs("--adjusted", adjusted, "E_C0Y=0, each error once"):
        values.append(adjustment(errors, loaded, name, number("--adjusted", text, entry)))
    with progress_bar() as bar:
        found = run(
            None if is_calibration else Measurements.load(before, loaded),
            Measurements.load(after, loaded),
            loaded,
            calibration=errors,
            written=values,
            tool_length_mm=length,
            progress=bar,
        )
    if html_file is not None:
        write_atomic(html_file, found.to_html())
    return CommandResult(found.to_text(), found.to_dict, met=found.met)
