"""``twin identify``."""

from __future__ import annotations

import fnmatch
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twin._common.errors import InputError, nearest
from twin._common.files import scratch_folder, write_json
from twin.cli import complete
from twin.cli.app import (
    NOT_ALL_MET,
    MachineOption,
    progress,
)
from twin.cli.options import instrument_named, tables_on
from twin.cli.outputs import CALIBRATION, JsonOption, command
from twin.cli.terminal import echo
from twin.identification import identify as run_identification
from twin.machine.calibration import Calibration
from twin.machine.machine import DEFAULT, Machine
from twin.measurement.instruments import INSTRUMENTS
from twin.measurement.table import joined
from twin.measurement.table import load as load_measurements


class Scatter(StrEnum):
    """Whose scatter an uncertainty carries."""

    stated = "stated"
    repeats = "repeats"
    between_poses = "between poses"
    between_rounds = "between rounds"


@command(
    "twin identify measured.csv -o mine.yaml --json identified.json",
    "twin identify measured.csv -o x.yaml --only E_*X",
    "twin identify measured.csv -o mine.yaml --uncertainty 'between poses'",
    "twin identify measured.csv -o left.yaml --control linuxcnc=X.comp --control linuxcnc=joints.ini",
)
def identify(
    measured: Annotated[
        list[Path],
        typer.Argument(help="The measurement table, or several of one machine.", autocompletion=complete.tables),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The calibration."), CALIBRATION],
    machine: MachineOption = DEFAULT,
    instrument: Annotated[
        str | None,
        typer.Option(
            "--instrument",
            help=f"{', '.join(one.name for one in INSTRUMENTS)}; if not given: interferometer if only lengths were read, else tracker.",
            autocompletion=complete.instruments,
        ),
    ] = None,
    spread: Annotated[
        Scatter,
        typer.Option(
            "--uncertainty",
            help="From the readings' stated uncertainty, their repeats, or from pose to pose (where the model leaves something out).",
        ),
    ] = Scatter.stated,
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only",
            help="Errors to seek, by name; * for any letter: E_*X E_C0Y E_*0C.",
            autocompletion=complete.errors,
        ),
    ] = None,
    control: Annotated[
        list[str] | None,
        typer.Option(
            "--control",
            help="FORMAT=FILE, once a file: the control's own tables that were on while it was measured (twin doc control).",
        ),
    ] = None,
    json_file: JsonOption = None,
) -> None:
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
            instrument=None if instrument is None else instrument_named(instrument),
            wanted=lambda name: only is None or any(fnmatch.fnmatchcase(name, pattern) for pattern in only),
            spread=spread.value,
            say=say,
        )
    calibration = found.calibration.with_control(tables)
    with scratch_folder() as folder:
        # What is reported is what the file does: written, read back and evaluated on the rows before it takes its place.
        calibration.save(folder / output.name)
        found = found.as_written(replace(Calibration.load(folder / output.name, loaded), path=None))
    calibration.save(output)
    if json_file is not None:
        write_json(json_file, found.to_dict())
    echo(found.to_text(), end="")
    if tables is not None:
        echo(
            "\nThese errors are what the control's tables left: leave them on; add to them, never replace them (twin control --add)."
            + (f"\n{tables.caution}" if tables.caution else "")
        )
    echo(f"\nwritten: {', '.join(str(path) for path in (output, json_file) if path is not None)}")
    if not found.complete:
        raise typer.Exit(NOT_ALL_MET)
