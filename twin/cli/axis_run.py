"""``twin axis-run`` and ``twin simulate-run``: one linear axis under a multi-axis interferometer."""

from __future__ import annotations

from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from twin._common.errors import InputError
from twin._common.provenance import SIMULATED, merged, to_json
from twin.cli.shared import complete, options
from twin.cli.shared.command import CALIBRATION, TABLE, CommandResult, JsonOption, command
from twin.cli.shared.words import three_numbers
from twin.identification.axis_run import (
    AxisLayout,
    axis_curves,
    error_motions,
    load_readings,
    simulate_run,
    to_dict,
    to_text,
)
from twin.machine.machine import DEFAULT, Machine

MOST_ROWS = 30_000
"""Of a simulated run: what `twin axis-run` can work out."""

LayoutOption = Annotated[
    Path,
    typer.Option(
        "--layout",
        "-l",
        help="The interferometer's layout file, or one that comes with twin.",
        autocompletion=complete.layouts,
    ),
]


class RunScatter(StrEnum):
    """Whose scatter an uncertainty carries."""

    stated = "stated"
    repeats = "repeats"


@command(
    "twin simulate-run --layout nine_beams_x.yaml --positions 0,500,21 -o run.csv",
    "twin axis-run run.csv --layout nine_beams_x.yaml -o x_axis.yaml --json x_axis.json",
    name="axis-run",
)
def axis_run(
    readings: Annotated[
        Path, typer.Argument(help="The table of readings: a column a beam.", autocompletion=complete.tables)
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The calibration: six curves of the axis."), CALIBRATION
    ],
    layout: LayoutOption,
    machine: options.MachineOption = DEFAULT,
    spread: Annotated[
        RunScatter, typer.Option("--uncertainty", help="From the beams' stated noise, or from the scatter of repeats.")
    ] = RunScatter.stated,
    json_file: JsonOption = None,
) -> CommandResult:
    """Six error motions of one linear axis from a multi-axis interferometer's readings, with their uncertainty."""
    loaded = Machine.load(machine)
    standing = AxisLayout.load(_layout_file(layout), loaded)
    data = load_readings(readings, standing)
    motions = error_motions(standing, data, spread=spread.value)
    curves = axis_curves(
        motions, loaded, source=f"measured by {standing.name} and twin from {data.source}: {len(data)} rows"
    )
    curves.calibration.save(output)
    found = (standing, data, motions, curves)
    return CommandResult(to_text(*found), lambda: to_dict(*found), met=not data.set_aside)


@command(
    "twin simulate-run --layout nine_beams_x.yaml --positions 0,500,21 -o run.csv --seed 7",
    "twin simulate-run --layout nine_beams_x.yaml --positions 0,500,21 -o quiet.csv --no-noise --json quiet.json",
    name="simulate-run",
)
def simulate_axis_run(
    output: Annotated[Path, typer.Option("--output", "-o", help="The table of readings."), TABLE],
    layout: LayoutOption,
    positions: Annotated[str, typer.Option("--positions", help="from,to,count of the axis (mm).")],
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    rounds: Annotated[int, typer.Option("--rounds", help="Forth and back so often.")] = 3,
    seed: Annotated[int, typer.Option("--seed", help="Of the noise and of how the layout really stands.")] = 0,
    noise: Annotated[bool, typer.Option("--noise/--no-noise", help="Whether the readings err.")] = True,
    json_file: JsonOption = None,
) -> CommandResult:
    """Run one linear axis of the machine with the errors of a calibration, read by a multi-axis interferometer."""
    loaded = Machine.load(machine)
    standing = AxisLayout.load(_layout_file(layout), loaded)
    for name, value in (("--seed", seed), ("--rounds", rounds - 1)):
        if value < 0:
            raise InputError(f"{name} is too small", expected="--seed 0 or more, --rounds 1 or more", value=value)
    forth = _positions(positions, standing)
    n = len(forth)
    if 2 * n * rounds > MOST_ROWS:
        raise InputError(
            f"{n} positions forth and back in {rounds} rounds are too many", expected=f"at most {MOST_ROWS} rows"
        )
    truth = options.calibration_of(calibration, loaded)
    table, stands = simulate_run(
        standing,
        loaded,
        truth,
        np.tile(np.concatenate([forth, forth[::-1]]), rounds),
        np.random.default_rng(seed),
        rounds=np.repeat([str(k + 1) for k in range(rounds)], 2 * n),
        approach=np.tile(np.repeat([1.0, -1.0], n), rounds),
        noise=noise,
    )
    known = ", ".join(
        f"{name} {value:.3g}" for name, value in zip(standing.beams.installation, stands, strict=True) if value
    )
    comment = (
        f"simulated by twin {version('twin')}: {loaded.name}, calibration {truth.path or 'none'}, {standing.name}, "
        f"seed {seed}, {'with' if noise else 'without'} noise\nthe layout really stands off by (m, rad, 1): {known}"
    )
    table.save(output, standing, comment=comment)
    told = {
        "schema": "twin.simulated_run/1",
        "readings": str(output),
        "machine": loaded.name,
        "calibration": None if truth.path is None else str(truth.path),
        "illustrative": truth.illustrative,
        "warnings": to_json(merged([SIMULATED], truth.warnings)),
        "layout": standing.name,
        "axis": standing.axis.name,
        "seed": seed,
        "noise": noise,
        "rows": len(table),
        "stands_off": dict(zip(standing.beams.installation, (float(v) for v in stands), strict=True)),
    }
    return CommandResult("", lambda: told, written=f"written: {{}}, {len(table)} rows")


def _layout_file(path: Path) -> Path:
    return options.bundled_sample(path, "layout", "layout file", ["nine_beams_x.yaml"])


def _positions(text: str, layout: AxisLayout) -> np.ndarray:
    first, last, count = three_numbers("--positions", text, text, "from,to,count")
    lower, upper = layout.axis.lower, layout.axis.upper
    inside = lower is None or upper is None or lower <= min(first, last) <= max(first, last) <= upper
    if not inside or not first < last or count != int(count) or count < 2:
        span = "" if lower is None else f" from {lower:g} to {upper:g}"
        raise InputError(
            "--positions does not fit", expected=f"rising positions{span} mm and a count of 2 or more", value=text
        )
    if count > MOST_ROWS:
        raise InputError("--positions has too many", expected=f"a count of at most {MOST_ROWS}", value=text)
    return np.linspace(first, last, int(count))
