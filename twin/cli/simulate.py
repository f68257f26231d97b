"""Command ``twin simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import require_name
from twin._common.families import INSTRUMENTS
from twin._common.provenance import SIMULATED, merge_warnings, warnings_to_json
from twin._common.units import count_with_noun
from twin.cli.shared import complete, options
from twin.cli.shared.command import TABLE, CommandResult, JsonOption, command, progress_bar
from twin.cli.shared.terminal import not_negative, pairs, three_numbers

if TYPE_CHECKING:
    from twin.measurement.simulate import Environment
    from twin.model.calibration import Calibration

PlanArgument = Annotated[
    Path,
    typer.Argument(
        help="Measurement table, or a bundled plan, with the poses to measure; its measured coordinates are ignored.",
        autocompletion=complete.plans,
    ),
]
InstrumentOption = Annotated[
    str, typer.Option("--instrument", help="Simulated instrument: {instruments}.", autocompletion=complete.instruments)
]
AirOption = Annotated[
    str | None,
    typer.Option("--air", help="Air along the beam, T,p,RH in °C, hPa, %; the instrument assumes 20,1013.25,50."),
]
DriftOption = Annotated[
    list[str] | None,
    typer.Option("--drift", help="Drift of a station in the base frame, µm/h: STATION=x,y,z; needs column time_s."),
]


@command(
    "twin simulate thesis_plan.csv -o measured.csv --seed 7",
    "twin simulate thesis_plan.csv -o lengths.csv --instrument interferometer --json lengths.json",
    "twin simulate plan.csv -o measured.csv --calibration mine.yaml --air 22,1000,40",
)
def simulate(
    plan: PlanArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="Measurement table to write."), TABLE],
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    instrument: InstrumentOption = "tracker",
    seed: Annotated[
        int, typer.Option("--seed", help="Random seed of the noise and of unspecified station and target positions.")
    ] = 0,
    noise: Annotated[bool, typer.Option("--noise/--no-noise", help="Add measurement noise.")] = True,
    air: AirOption = None,
    drift: DriftOption = None,
    json_file: JsonOption = None,
) -> CommandResult:
    """Simulate the measurement of a plan on the machine with the errors of a calibration."""
    require_name("instrument", instrument, INSTRUMENTS)
    not_negative("--seed", seed)
    source = options.plan_file(plan)
    from numpy.random import default_rng

    from twin.measurement.columns import grouped_notes
    from twin.measurement.instruments import instrument_named
    from twin.measurement.simulate import simulate as run_simulation
    from twin.measurement.table import Measurements

    loaded = options.machine(machine)
    reader, around = instrument_named(instrument), _surroundings(air, drift)
    truth = options.calibration_of(calibration, loaded)
    with progress_bar() as bar:
        bar("reading", 0.0)
        planned = Measurements.load(source, loaded, plan=True)
        bar("measuring", 0.3)
        measured, setting = run_simulation(
            planned, loaded, truth, reader, default_rng(seed), noise=noise, surroundings=around
        )
    comment = (simulated_by(truth, f"instrument {reader.name}", seed, noise), around.describe(), setting.describe())
    measured.save(output, loaded, comment="\n".join(filter(None, comment)))
    report = {
        "schema": "twin.simulation/1",
        "measured": str(output),
        "plan": str(source),
        "machine": loaded.name,
        "calibration": None if truth.path is None else str(truth.path),
        "illustrative": truth.illustrative,
        "warnings": warnings_to_json(merge_warnings([SIMULATED], truth.warnings)),
        "instrument": reader.name,
        "seed": seed,
        "noise": noise,
        "surroundings": around.describe(),
        "setting": setting.describe(),
        "points": len(measured),
        "set_aside": [{"line": note.line, "why": note.text} for note in planned.set_aside],
        "notices": list(planned.notices),
    }
    excluded = (f"set aside, {text}" for text in grouped_notes(planned.set_aside))
    off = [MODULE_OFF] if truth.corrected_in_control else []
    return CommandResult(
        "",
        lambda: report,
        met=not planned.set_aside,
        written=f", {count_with_noun(len(measured), 'point')}",
        after=[f"  {text}" for text in (*excluded, *planned.notices, *off)],
    )


MODULE_OFF = "the machine is simulated with the kinematics module in its control switched off"


def simulated_by(truth: Calibration, instrument: str, seed: int, noise: bool) -> str:
    """Return the first comment of a simulated table."""
    from importlib.metadata import version

    origin = f"simulated by twin {version('twin')}: {truth.machine.name}, calibration {truth.path or 'none'}"
    return f"{origin}, {instrument}, seed {seed}, {'with' if noise else 'without'} noise"


def _surroundings(air: str | None, drift: list[str] | None) -> Environment:
    from twin.measurement.instruments import Air
    from twin.measurement.simulate import Environment

    rates: dict[str, tuple[float, float, float]] = {}
    for name, text, entry in pairs("--drift", drift, "STATION=x,y,z in µm/h, each station once", last=True):
        rates[name] = three_numbers("--drift", text, entry, "x,y,z in µm/h")
    if air is None:
        return Environment(None, rates)
    temperature, pressure, humidity = three_numbers("--air", air, air, "T,p,RH in °C, hPa and %")
    return Environment(Air(temperature, pressure, humidity / 100.0), rates)
