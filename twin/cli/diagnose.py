"""``twin diagnose``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin._common.errors import InputError
from twin._common.files import write_json, write_whole
from twin.cli import complete
from twin.cli.app import (
    NOT_ALL_MET,
    CalibrationOption,
    MachineOption,
    calibration_of,
    need_pictures,
    progress,
)
from twin.cli.options import instrument_named
from twin.cli.outputs import CALIBRATION, HTML, JsonOption, command
from twin.cli.terminal import echo
from twin.diagnosis import diagnose as run_diagnosis
from twin.machine.machine import DEFAULT, Machine
from twin.measurement.table import joined
from twin.measurement.table import load as load_measurements


@command(
    "twin diagnose measured.csv --calibration mine.yaml --html diagnosis.html",
    "twin diagnose first.csv second.csv -c mine.yaml --json diagnosis.json --extended better.yaml",
    "twin diagnose measured.csv -c mine.yaml --extended better.yaml --empirical",
)
def diagnose(
    measured: Annotated[
        list[Path],
        typer.Argument(help="The measurement table, or several of one machine.", autocompletion=complete.tables),
    ],
    machine: MachineOption = DEFAULT,
    calibration: CalibrationOption = None,
    instrument: Annotated[
        str | None,
        typer.Option(
            "--instrument",
            help="Whose scatter to take; if not given: the table's uncertainties, else the repeats'.",
            autocompletion=complete.instruments,
        ),
    ] = None,
    json_file: JsonOption = None,
    html_file: Annotated[Path | None, typer.Option("--html", help="Write the report as one HTML file."), HTML] = None,
    extended: Annotated[
        Path | None,
        typer.Option("--extended", help="Write the calibration with what was found of the machine."),
        CALIBRATION,
    ] = None,
    empirical: Annotated[
        bool,
        typer.Option(
            "--empirical",
            help="Also write what has no known cause, where readings held out confirm it; valid only inside the range measured.",
        ),
    ] = False,
) -> None:
    """Show what the model gets wrong about measured data, and name the cause."""
    if empirical and extended is None:
        raise InputError("--empirical without a file to write", expected="--extended CALIBRATION.yaml as well")
    if html_file is not None:
        need_pictures("the HTML report")
    loaded = Machine.load(machine)
    outputs = [path for path in (json_file, html_file, extended) if path is not None]
    errors = calibration_of(calibration, loaded)
    with progress() as say:
        say("reading", 0.0)
        data = joined([load_measurements(path, loaded) for path in measured])
        reader = None if instrument is None else instrument_named(instrument)
        found = run_diagnosis(data, loaded, errors, instrument=reader, empirical=empirical, say=say)
    if extended is not None:
        found.extended.save(extended)
    if json_file is not None:
        write_json(json_file, found.to_dict())
    if html_file is not None:
        from twin.diagnosis.wording.report import (
            diagnosis_html,  # matplotlib takes its time, and only this option needs it
        )

        write_whole(html_file, diagnosis_html(found))
    echo(found.to_text(), end="")
    if outputs:
        echo(f"\nwritten: {', '.join(str(path) for path in outputs)}")
    if found.data.set_aside:
        raise typer.Exit(NOT_ALL_MET)
