"""``twin simulate``."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from twin.cli.app import (
    NOT_ALL_MET,
    CalibrationOption,
    MachineOption,
    app,
    calibration_of,
)
from twin.errors import InputError
from twin.files import check_writable
from twin.instruments import INSTRUMENTS
from twin.machine import Machine
from twin.measurement import load as load_measurements
from twin.options import instrument_named, plan_file, surroundings
from twin.simulate import simulate as run_simulation


@app.command()
def simulate(
    plan: Annotated[
        Path,
        typer.Argument(
            help="What to measure: a measurement table, or one that comes with twin; its coordinates are not looked at."
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The measured data.")],
    machine: MachineOption = "dmu50",
    calibration: CalibrationOption = None,
    instrument: Annotated[
        str, typer.Option("--instrument", help=", ".join(one.name for one in INSTRUMENTS))
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
) -> None:
    """Measure a plan on the machine with the errors of a calibration, as an instrument would.

    twin simulate thesis_plan.csv -o measured.csv --instrument tracker --seed 7
    """
    loaded = Machine.load(machine)
    reader = instrument_named(instrument)
    if seed < 0:
        raise InputError("--seed is negative", expected="0 or more", value=seed)
    around = surroundings(air, drift)
    source = plan_file(plan)
    check_writable([output])
    if source.resolve() == output.resolve():
        raise InputError("the output is the plan itself", expected="another file", file=output)
    truth = calibration_of(calibration, loaded)
    planned = load_measurements(source, loaded, plan=True)
    rng = np.random.default_rng(seed)
    measured, setting = run_simulation(planned, loaded, truth, reader, rng, noise=noise, surroundings=around)
    comment = [
        f"simulated by twin {version('twin')}: {loaded.name}, calibration {truth.path or 'none'}, instrument {reader.name}, "
        f"seed {seed}, {'with' if noise else 'without'} noise",
        around.describe(),
        setting.describe(),
    ]
    measured.save(output, loaded, comment="\n".join(part for part in comment if part))
    print(f"written: {output}, {len(measured)} points")
    for note in planned.set_aside:
        print(f"  line {note.line} set aside: {note.text}")
    for notice in planned.notices:
        print(f"  {notice}")
    if planned.set_aside:
        raise typer.Exit(NOT_ALL_MET)
