"""Commands ``twin axis-run`` and ``twin simulate-run``: one linear axis measured by a multi-axis interferometer."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError
from twin._common.provenance import SIMULATED, merge_warnings, warnings_to_json
from twin._common.units import count_with_noun
from twin.cli.shared import complete, options
from twin.cli.shared.command import CALIBRATION, EXISTING, TABLE, CommandResult, JsonOption, command
from twin.cli.shared.terminal import three_numbers
from twin.cli.simulate import simulated_by

if TYPE_CHECKING:
    import numpy as np

    from twin.identification.axis_layout import AxisLayout

MOST_ROWS = 30_000
"""Largest number of rows of a simulated run, as many as `twin axis-run` can evaluate."""

LayoutOption = Annotated[
    Path,
    typer.Option(
        "--layout",
        "-l",
        help="Layout file of the interferometer, or the name of a bundled one.",
        autocompletion=complete.layouts,
    ),
]


class RunUncertaintyChoice(StrEnum):
    """Source of the noise from which uncertainties of an axis run are computed."""

    stated = "stated"
    repeats = "repeats"


@command(
    "twin simulate-run --layout nine_beams_x.yaml --positions 0,500,21 -o run.csv",
    "twin axis-run run.csv --layout nine_beams_x.yaml -o x_axis.yaml --json x_axis.json",
    name="axis-run",
)
def axis_run(
    readings: Annotated[
        Path, typer.Argument(help="Table of readings, one column per beam.", autocompletion=complete.tables), EXISTING
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Calibration file to write: six curves of the axis."), CALIBRATION
    ],
    layout: LayoutOption,
    machine: options.MachineOption = DEFAULT,
    noise_source: Annotated[
        RunUncertaintyChoice,
        typer.Option("--uncertainty", help="Noise that the uncertainties are computed from: as stated, or of repeats."),
    ] = RunUncertaintyChoice.stated,
    json_file: JsonOption = None,
) -> CommandResult:
    """Determine the six error motions of a linear axis, with uncertainties, from readings of a multi-axis interferometer."""
    from twin.identification.axis_layout import AxisLayout, load_readings
    from twin.identification.axis_run import axis_curves, error_motions, to_dict, to_text

    loaded = options.machine(machine)
    axis_layout = AxisLayout.load(_layout_file(layout), loaded)
    data = load_readings(readings, axis_layout)
    motions = error_motions(axis_layout, data, spread=noise_source.value)
    curves = axis_curves(
        motions,
        loaded,
        source=f"measured by {axis_layout.name} and twin from {data.source}: {count_with_noun(len(data), 'row')}",
    )
    curves.calibration.save(output)
    results = (axis_layout, data, motions, curves)
    return CommandResult(to_text(*results), lambda: to_dict(*results), met=not data.set_aside)


@command(
    "twin simulate-run --layout nine_beams_x.yaml --positions 0,500,21 -o run.csv --seed 7",
    "twin simulate-run --layout nine_beams_x.yaml --positions 0,500,21 -o quiet.csv --no-noise --json quiet.json",
    name="simulate-run",
)
def simulate_axis_run(
    output: Annotated[Path, typer.Option("--output", "-o", help="Table of readings to write."), TABLE],
    layout: LayoutOption,
    positions: Annotated[str, typer.Option("--positions", help="Positions of the axis: from,to,count; mm.")],
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    rounds: Annotated[int, typer.Option("--rounds", help="Number of bidirectional runs.")] = 3,
    seed: Annotated[int, typer.Option("--seed", help="Random seed of the noise and of the installation errors.")] = 0,
    noise: Annotated[bool, typer.Option("--noise/--no-noise", help="Add measurement noise.")] = True,
    json_file: JsonOption = None,
) -> CommandResult:
    """Simulate a run of one linear axis with the errors of a calibration, measured by a multi-axis interferometer."""
    import numpy as np

    from twin.identification.axis_layout import AxisLayout, simulate_run

    loaded = options.machine(machine)
    axis_layout = AxisLayout.load(_layout_file(layout), loaded)
    for name, value in (("--seed", seed), ("--rounds", rounds - 1)):
        if value < 0:
            raise InputError(f"{name} is too small", expected="--seed 0 or more, --rounds 1 or more", value=value)
    forth = _positions(positions, axis_layout)
    n = len(forth)
    if 2 * n * rounds > MOST_ROWS:
        raise InputError(
            f"{n} positions in {rounds} bidirectional rounds are too many", expected=f"at most {MOST_ROWS} rows"
        )
    truth = options.calibration_of(calibration, loaded)
    table, stands = simulate_run(
        axis_layout,
        loaded,
        truth,
        np.tile(np.concatenate([forth, forth[::-1]]), rounds),
        np.random.default_rng(seed),
        rounds=np.repeat([str(k + 1) for k in range(rounds)], 2 * n),
        approach=np.tile(np.repeat([1.0, -1.0], n), rounds),
        noise=noise,
    )
    installed = dict(zip(axis_layout.beams.installation, (float(v) for v in stands), strict=True))
    known = ", ".join(f"{name} {value:.3g}" for name, value in installed.items() if value)
    comment = (
        f"{simulated_by(truth, axis_layout.name, seed, noise)}\ninstallation errors of the layout (m, rad, 1): {known}"
    )
    table.save(output, axis_layout, comment=comment)
    report = {
        "schema": "twin.simulated_run/1",
        "readings": str(output),
        "machine": loaded.name,
        "calibration": None if truth.path is None else str(truth.path),
        "illustrative": truth.illustrative,
        "warnings": warnings_to_json(merge_warnings([SIMULATED], truth.warnings)),
        "layout": axis_layout.name,
        "axis": axis_layout.axis.name,
        "seed": seed,
        "noise": noise,
        "rows": len(table),
        "stands_off": installed,
    }
    return CommandResult("", lambda: report, written=f", {count_with_noun(len(table), 'row')}")


def _layout_file(path: Path) -> Path:
    return options.bundled_sample(path, "layout", "layout file", ["nine_beams_x.yaml"])


def _positions(text: str, layout: AxisLayout) -> np.ndarray:
    import numpy as np

    first, last, count = three_numbers("--positions", text, text, "from,to,count")
    lower, upper = layout.axis.lower, layout.axis.upper
    inside = lower is None or upper is None or lower <= min(first, last) <= max(first, last) <= upper
    if not inside or not first < last or count != int(count) or count < 2:
        span = "" if lower is None else f" from {lower:g} to {upper:g}"
        raise InputError(
            "--positions cannot be used", expected=f"ascending positions{span} mm and a count of 2 or more", value=text
        )
    if count > MOST_ROWS:
        raise InputError("--positions: count too large", expected=f"a count of at most {MOST_ROWS}", value=text)
    return np.linspace(first, last, int(count))
