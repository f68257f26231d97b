"""``twin identify``."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twin._common.errors import InputError, nearest
from twin._common.files import scratch_folder
from twin.cli.shared import complete, options
from twin.cli.shared.command import CALIBRATION, CommandResult, JsonOption, command, progress
from twin.identification import identify as run_identification
from twin.machine.calibration import Calibration
from twin.machine.control import FORMATS, ControlSection, TableEntry, read_tables
from twin.machine.machine import DEFAULT, Machine
from twin.measurement.instruments import INSTRUMENTS
from twin.measurement.table import joined
from twin.measurement.table import load as load_measurements


class ScatterChoice(StrEnum):
    """Whose scatter an uncertainty carries."""

    stated = "stated"
    repeats = "repeats"
    between_poses = "between poses"
    between_rounds = "between rounds"


InstrumentOption = Annotated[
    str | None,
    typer.Option(
        "--instrument",
        help=f"{', '.join(one.name for one in INSTRUMENTS)}; if not given: interferometer if only lengths were read, else tracker.",
        autocompletion=complete.instruments,
    ),
]
UncertaintyOption = Annotated[
    ScatterChoice,
    typer.Option(
        "--uncertainty",
        help="From the readings' stated uncertainty, their repeats, or from pose to pose (where the model leaves something out).",
    ),
]
OnlyOption = Annotated[
    list[str] | None,
    typer.Option(
        "--only", help="Errors to seek, by name; * for any letter: E_*X E_C0Y E_*0C.", autocompletion=complete.errors
    ),
]
ControlOption = Annotated[
    list[str] | None,
    typer.Option(
        "--control",
        help="FORMAT=FILE, once a file: the control's own tables that were on while it was measured (twin doc control).",
    ),
]


@command(
    "twin identify measured.csv -o mine.yaml --json identified.json",
    "twin identify measured.csv -o x.yaml --only E_*X",
    "twin identify measured.csv -o mine.yaml --uncertainty 'between poses'",
    "twin identify measured.csv -o left.yaml --control linuxcnc=X.comp --control linuxcnc=joints.ini",
)
def identify(
    measured: options.MeasuredArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="The calibration."), CALIBRATION],
    machine: options.MachineOption = DEFAULT,
    instrument: InstrumentOption = None,
    spread: UncertaintyOption = ScatterChoice.stated,
    only: OnlyOption = None,
    control: ControlOption = None,
    json_file: JsonOption = None,
) -> CommandResult:
    """Identify error motions, squareness and axis locations from measured points, with their uncertainty."""
    loaded = Machine.load(machine)
    names = (*loaded.motion_names, *loaded.squareness_names, *loaded.location_names)
    for pattern in only or []:
        if not fnmatch.filter(names, pattern):
            raise InputError(
                "--only names no error of this machine",
                expected=f"among {', '.join(names)}",
                value=pattern,
                nearest=nearest(pattern, names),
            )
    tables = tables_on(control, loaded) if control else None
    with progress() as say:
        say("reading", 0.0)
        data = joined([load_measurements(path, loaded) for path in measured])
        found = run_identification(
            data,
            loaded,
            instrument=None if instrument is None else options.instrument_named(instrument),
            wanted=lambda name: only is None or any(fnmatch.fnmatchcase(name, pattern) for pattern in only),
            spread=spread.value,
            say=say,
        )
    calibration = found.calibration.with_control(tables)
    with scratch_folder() as folder:
        # What is reported is what the file does: written, read back and evaluated on the rows before it takes its place.
        calibration.save(folder / output.name)
        found = found.evaluated_with(replace(Calibration.load(folder / output.name, loaded), path=None))
    calibration.save(output)
    text = found.to_text()
    if tables is not None:
        text += "\nThese errors are what the control's tables left: leave them on; add to them, never replace them "
        text += "(twin control --add).\n"
        text += f"{tables.caution}\n" if tables.caution else ""
    return CommandResult(text, found.to_dict, met=found.complete)


def tables_on(entries: Sequence[str], machine: Machine) -> ControlSection:
    """The control's tables that were on while a machine was measured, from ``FORMAT=FILE`` each.

    Raises:
        InputError: no such format; a file that cannot be read, or is no such table for this machine.
    """
    found: dict[str, list[Path]] = {}
    known = [form.name for form in FORMATS]
    for entry in entries:
        kind, equals, file = entry.partition("=")
        if not equals or kind not in known:
            raise InputError(
                "--control does not fit",
                expected=f"FORMAT=FILE, each file of the control once, FORMAT one of {', '.join(known)}",
                value=entry,
                nearest=nearest(kind, known),
            )
        found.setdefault(kind, []).append(Path(file))
    for kind, files in found.items():
        read_tables(kind, files, machine)
    return ControlSection(
        "remaining", tuple(TableEntry.of(file, kind, ()) for kind, files in found.items() for file in files)
    )
