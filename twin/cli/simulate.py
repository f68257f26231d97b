"""``twin simulate``."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from twin._common.errors import InputError
from twin._common.files import write_json
from twin._common.provenance import SIMULATED, merged, to_json
from twin.cli import complete
from twin.cli.app import (
    NOT_ALL_MET,
    CalibrationOption,
    MachineOption,
    calibration_of,
    progress,
)
from twin.cli.options import instrument_named, plan_file, surroundings
from twin.cli.outputs import TABLE, JsonOption, command
from twin.cli.terminal import echo
from twin.machine.machine import DEFAULT, Machine
from twin.measurement.checks import grouped_notes
from twin.measurement.instruments import INSTRUMENTS
from twin.measurement.simulate import simulate as run_simulation
from twin.measurement.table import load as load_measurements


@command(
    "twin simulate thesis_plan.csv -o measured.csv --seed 7",
    "twin simulate thesis_plan.csv -o lengths.csv --instrument interferometer --json lengths.json",
    "twin simulate plan.csv -o measured.csv --calibration mine.yaml --air 22,1000,40",
)
def simulate(
    plan: Annotated[
        Path,
        typer.Argument(
            help="What to measure: a measurement table, or one that comes with twin; its coordinates are not looked at.",
            autocompletion=complete.plans,
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The measured data."), TABLE],
    machine: MachineOption = DEFAULT,
    calibration: CalibrationOption = None,
    instrument: Annotated[
        str,
        typer.Option(
            "--instrument",
            help=", ".join(one.name for one in INSTRUMENTS),
            autocompletion=complete.instruments,
        ),
    ] = "tracker",
    seed: Annotated[int, typer.Option("--seed", help="Of the noise, and of stations and targets nobody placed.")] = 0,
    noise: Annotated[bool, typer.Option("--noise/--no-noise", help="Whether the readings err.")] = True,
    air: Annotated[
        str | None,
        typer.Option("--air", help="T,p,RH along the beam (°C, hPa, %), where the instrument assumes 20,1013.25,50."),
    ] = None,
    drift: Annotated[
        list[str] | None,
        typer.Option("--drift", help="STATION=x,y,z: how its frame creeps in the base frame (µm/h); needs time_s."),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Measure a plan on the machine with the errors of a calibration, as an instrument would."""
    loaded = Machine.load(machine)
    reader = instrument_named(instrument)
    if seed < 0:
        raise InputError("--seed is negative", expected="0 or more", value=seed)
    around = surroundings(air, drift)
    source = plan_file(plan)
    outputs = [path for path in (output, json_file) if path is not None]
    truth = calibration_of(calibration, loaded)
    with progress() as say:
        say("reading", 0.0)
        planned = load_measurements(source, loaded, plan=True)
        say("measuring", 0.3)
        rng = np.random.default_rng(seed)
        measured, setting = run_simulation(planned, loaded, truth, reader, rng, noise=noise, surroundings=around)
    comment = [
        f"simulated by twin {version('twin')}: {loaded.name}, calibration {truth.path or 'none'}, instrument {reader.name}, "
        f"seed {seed}, {'with' if noise else 'without'} noise",
        around.describe(),
        setting.describe(),
    ]
    measured.save(output, loaded, comment="\n".join(part for part in comment if part))
    if json_file is not None:
        told = {
            "schema": "twin.simulation/1",
            "measured": str(output),
            "plan": str(source),
            "machine": loaded.name,
            "calibration": None if truth.path is None else str(truth.path),
            "illustrative": truth.illustrative,
            "warnings": to_json(merged([SIMULATED], truth.warnings)),
            "instrument": reader.name,
            "seed": seed,
            "noise": noise,
            "surroundings": around.describe(),
            "setting": setting.describe(),
            "points": len(measured),
            "set_aside": [{"line": note.line, "why": note.text} for note in planned.set_aside],
            "notices": list(planned.notices),
        }
        write_json(json_file, told)
    echo(f"written: {', '.join(str(path) for path in outputs)}, {len(measured)} points")
    for text in grouped_notes(planned.set_aside):
        echo(f"  set aside, {text}")
    for notice in planned.notices:
        echo(f"  {notice}")
    if planned.set_aside:
        raise typer.Exit(NOT_ALL_MET)
