"""Command ``twin plan``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin._common.errors import InputError
from twin._common.provenance import warning_texts, warnings_to_json
from twin.cli.shared import complete, options
from twin.cli.shared.command import POSITIVE, TABLE, CommandResult, JsonOption, command, progress_bar
from twin.machine.calibration import Calibration
from twin.machine.machine import DEFAULT, Machine
from twin.measurement.checks import grouped_notes
from twin.measurement.instruments import INSTRUMENTS
from twin.measurement.table import Measurements
from twin.planning import Kit, duration, judge, separate
from twin.planning import plan as make_plan
from twin.planning.kit import bundled_kit

MINUTES = 210.0
MINUTES_TO_SEPARATE = 60.0

KitOption = Annotated[
    Path | None,
    typer.Option(
        "--kit",
        help="File of the available instruments and targets (schema twin.kit/1), or the bundled dmu50; default: an assumed kit.",
        autocompletion=complete.kits,
    ),
]
MinutesOption = Annotated[
    float | None,
    typer.Option("--minutes", help="Time budget in minutes, including set-up; default: 210, or 60 with --separate."),
    POSITIVE,
]
ReduceOption = Annotated[
    list[str] | None,
    typer.Option(
        "--reduce",
        help="Uncertainty to minimise: tool (default), everything (D-optimal), weakest (worst direction), or errors: E_C0Y E_*C.",
        autocompletion=complete.aims,
    ),
]
SeparateOption = Annotated[
    tuple[str, str] | None,
    typer.Option(
        "--separate",
        help='Two causes to distinguish, each in quotes: "reversal Y" "pitch_error X amplitude=2 period=10".',
        autocompletion=complete.causes,
    ),
]
AfterOption = Annotated[
    Path | None,
    typer.Option("--after", help="Table of previous measurements, with --separate.", autocompletion=complete.tables),
]
JudgeOption = Annotated[
    Path | None,
    typer.Option(
        "--judge",
        help="Evaluate this plan instead of making one: expected uncertainties and duration.",
        autocompletion=complete.plans,
    ),
]
InstrumentOption = Annotated[
    str,
    typer.Option(
        "--instrument",
        help=f"Instrument, with --judge: {', '.join(one.name for one in INSTRUMENTS)}.",
        autocompletion=complete.instruments,
    ),
]


@command(
    "twin plan -o plan.csv --minutes 120",
    "twin plan -o plan.csv --kit dmu50 --reduce E_C0Y E_A0Z",
    'twin plan -o plan.csv --separate "cross_axis E_AX by Z" "cross_axis E_AY by Z" --after measured.csv',
    "twin plan --judge thesis_plan.csv --json judged.json",
)
def plan(
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Plan to write: a measurement table without coordinates."),
        TABLE,
    ] = None,
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    kit: KitOption = None,
    minutes: MinutesOption = None,
    reduce: ReduceOption = None,
    causes: SeparateOption = None,
    after: AfterOption = None,
    judged: JudgeOption = None,
    instrument: InstrumentOption = "tracker",
    tool_length: options.ToolOption = None,
    seed: Annotated[int, typer.Option("--seed", help="Random seed of the candidate poses.")] = 0,
    json_file: JsonOption = None,
) -> CommandResult:
    """Plan the measurement that gives the smallest uncertainty in the available time."""
    loaded = Machine.load(machine)
    own = Kit.default(loaded) if kit is None else Kit.load(bundled_kit(kit), loaded)
    errors = options.calibration_of(calibration, loaded)
    if seed < 0:
        raise InputError("--seed must not be negative", expected="0 or more", value=seed)
    if (output is None) is (judged is None):
        raise InputError("no output, or two outputs", expected="either -o PLAN.csv or --judge PLAN.csv")
    if after is not None and causes is None:
        raise InputError("--after needs --separate", expected="two causes to distinguish", value=after)
    if causes is not None and reduce:
        raise InputError("--separate and --reduce exclude each other", expected="one of them", value=" ".join(reduce))
    if judged is not None:
        return _judged(judged, loaded, own, errors, instrument, tool_length)
    with progress_bar() as bar:
        if causes is not None:
            made = separate(
                loaded,
                *causes,
                own,
                minutes=MINUTES_TO_SEPARATE if minutes is None else minutes,
                calibration=errors,
                after=None if after is None else Measurements.load(after, loaded),
                seed=seed,
                progress=bar,
            )
        else:
            made = make_plan(
                loaded,
                own,
                minutes=MINUTES if minutes is None else minutes,
                reduce=reduce or "tool",
                expected=errors,
                tool_length_mm=tool_length,
                seed=seed,
                progress=bar,
            )
    if output is not None:
        made.save(output)
    return CommandResult(made.to_text(), made.to_dict, met=made.complete)


def _judged(
    plan: Path, machine: Machine, kit: Kit, errors: Calibration, instrument: str, tool_length_mm: float | None
) -> CommandResult:
    """Evaluate a given plan: expected uncertainties and duration."""
    table = Measurements.load(options.plan_file(plan), machine, plan=True)
    reader = options.instrument_named(instrument)
    with progress_bar() as bar:
        bar("judging", 0.0)
        forecast = judge(
            table, machine, instrument=reader, expected=errors, known=kit.known, tool_length_mm=tool_length_mm
        )
    minutes = duration(machine, kit, table) / 60.0
    lines = [
        f"{plan}: {len(table)} readings with {instrument}, {minutes:.0f} minutes according to the kit\n",
        *(f"expected errors: {text}" for text in warning_texts(errors.warnings)),
        forecast.to_text() + "".join(f"  set aside, {text}\n" for text in grouped_notes(table.set_aside)),
    ]
    report = {
        "schema": "twin.plan/1",
        "judged": str(plan),
        "minutes": minutes,
        "forecast": forecast.to_dict(),
        "warnings": warnings_to_json(errors.warnings),
    }
    return CommandResult("\n".join(lines), lambda: report, met=not table.set_aside)
