"""Command ``twin confirm``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError
from twin._common.families import Language
from twin.cli.shared import complete, options
from twin.cli.shared.command import EXISTING, HTML, CommandResult, JsonOption, command, progress_bar
from twin.cli.shared.paper import JobOption, LangOption, LogoOption, PdfOption, paper
from twin.cli.shared.terminal import number, pairs

if TYPE_CHECKING:
    from twin.machine.machine import Machine

AdjustedOption = Annotated[
    list[str] | None,
    typer.Option(
        "--adjusted", help="Squareness or location adjusted at the machine, and its new value: E_C0Y=0 (µrad, µm)."
    ),
]


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
    adjusted: AdjustedOption = None,
    tool_length: options.ToolOption = None,
    json_file: JsonOption = None,
    html_file: Annotated[Path | None, typer.Option("--html", help="Write the verdict to this HTML file."), HTML] = None,
    pdf_file: PdfOption = None,
    job: JobOption = None,
    logo: LogoOption = None,
    lang: LangOption = Language.en,
) -> CommandResult:
    """Confirm that tables, kinematics, an adjustment or a compensated program took effect; or that a crash moved nothing.

    Without --written, --compensated and --adjusted, it says which errors changed between BEFORE and AFTER, or gives an upper bound of
    the displacement of the tool. The exit status is 3 unless the verdict is that everything is confirmed, or that nothing moved.
    """
    from twin.measurement.table import Measurements
    from twin.model.calibration import Calibration
    from twin.monitoring import confirm as run
    from twin.monitoring import written_values

    page = paper(html_file, pdf_file, job, logo, lang, drawn=False)
    loaded = options.machine(machine)
    is_calibration = before.suffix.lower() in (".yaml", ".yml")
    if calibration is not None and is_calibration:
        raise InputError("two calibrations", expected="--calibration with readings BEFORE only", value=calibration)
    if written is not None and compensated:
        raise InputError("--written and --compensated exclude each other", expected="one of them", value=written)
    known = before if is_calibration else calibration
    if compensated and known is None:
        raise InputError("no calibration", expected="--calibration that the program was compensated with")
    tool_length = _tool_length(tool_length, written, loaded)
    entries = pairs("--adjusted", adjusted, "E_C0Y=0, each error once")
    errors, values = written_values(
        loaded,
        None if known is None else Calibration.load(known, loaded),
        folder=written,
        adjusted={name: number("--adjusted", text, entry) for name, text, entry in entries},
        compensated=compensated,
        tool_length_mm=tool_length,
    )
    with progress_bar() as bar:
        found = run(
            None if is_calibration else Measurements.load(before, loaded),
            Measurements.load(after, loaded),
            loaded,
            calibration=errors,
            written=values,
            tool_length_mm=tool_length,
            progress=bar,
        )
    page.write(found.to_html, [path for path in (before, after, calibration) if path is not None])
    return CommandResult(found.to_text(), found.to_dict, met=found.met)


def _tool_length(given: float | None, written: Path | None, machine: Machine) -> float | None:
    """Return the tool length that is given, else that of the written tables; None if neither is known."""
    from twin.model.calibration import Calibration

    if given is not None or written is None:
        return given
    control = Calibration.load(written / "calibration.yaml", machine).control
    return None if control is None else control.tool_length_mm
