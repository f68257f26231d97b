"""``twin plan``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin._common.errors import InputError
from twin._common.files import write_json
from twin._common.provenance import texts, to_json
from twin.cli import complete
from twin.cli.app import (
    NOT_ALL_MET,
    CalibrationOption,
    MachineOption,
    ToolOption,
    calibration_of,
    progress,
)
from twin.cli.options import instrument_named, plan_file, positive
from twin.cli.outputs import TABLE, JsonOption, command
from twin.cli.terminal import echo
from twin.machine.machine import DEFAULT, Machine
from twin.measurement.checks import grouped_notes
from twin.measurement.instruments import INSTRUMENTS
from twin.measurement.table import load as load_measurements
from twin.planning import Kit, duration, judge, separate
from twin.planning import plan as make_plan
from twin.planning.kit import bundled_kit

MINUTES = 210.0
MINUTES_TO_SEPARATE = 60.0


@command(
    "twin plan -o plan.csv --minutes 120",
    "twin plan -o plan.csv --kit dmu50 --reduce E_C0Y E_A0Z",
    'twin plan -o plan.csv --separate "cross_axis E_AX by Z" "cross_axis E_AY by Z" --after measured.csv',
    "twin plan --judge thesis_plan.csv --json judged.json",
)
def plan(
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The plan: a table without coordinates."), TABLE
    ] = None,
    machine: MachineOption = DEFAULT,
    calibration: CalibrationOption = None,
    kit: Annotated[
        Path | None,
        typer.Option(
            "--kit",
            help="What there is to measure with (schema twin.kit/1; dmu50 comes with twin); a guess if not given.",
            autocompletion=complete.kits,
        ),
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option("--minutes", help="That it may take, setting up included: 210, or 60 to separate two causes."),
    ] = None,
    reduce: Annotated[
        list[str] | None,
        typer.Option(
            "--reduce",
            help="What to make small: tool (default), everything (D-optimal), weakest (the worst direction), or errors: E_C0Y E_*C.",
            autocompletion=complete.aims,
        ),
    ] = None,
    causes: Annotated[
        tuple[str, str] | None,
        typer.Option(
            "--separate",
            help='Two causes to tell apart, quoted: "reversal Y" "pitch_error X amplitude=2 period=10".',
            autocompletion=complete.causes,
        ),
    ] = None,
    after: Annotated[
        Path | None,
        typer.Option(
            "--after",
            help="With --separate: what has been measured already (a table).",
            autocompletion=complete.tables,
        ),
    ] = None,
    judged: Annotated[
        Path | None,
        typer.Option(
            "--judge",
            help="Make no plan: say what this one will tell, and how long it takes.",
            autocompletion=complete.plans,
        ),
    ] = None,
    instrument: Annotated[
        str,
        typer.Option(
            "--instrument",
            help=f"With --judge: {', '.join(one.name for one in INSTRUMENTS)}.",
            autocompletion=complete.instruments,
        ),
    ] = "tracker",
    tool_length: ToolOption = None,
    seed: Annotated[int, typer.Option("--seed", help="Of the poses tried.")] = 0,
    json_file: JsonOption = None,
) -> None:
    """Plan the next measurement worth making: what tells most in the time there is."""
    loaded = Machine.load(machine)
    own = Kit.default(loaded) if kit is None else Kit.load(bundled_kit(kit), loaded)
    errors = calibration_of(calibration, loaded)
    if seed < 0:
        raise InputError("--seed is negative", expected="0 or more", value=seed)
    if minutes is not None:
        positive("--minutes", minutes)
    if (output is None) is (judged is None):
        raise InputError(
            "neither a plan to make nor one to judge", expected="-o PLAN.csv, or --judge PLAN.csv, not both"
        )
    outputs = [path for path in (output, json_file) if path is not None]
    if after is not None and causes is None:
        raise InputError("--after without --separate", expected="the two causes to tell apart", value=after)
    if causes is not None and reduce:
        raise InputError("--separate and --reduce", expected="one of them", value=" ".join(reduce))
    given = {path.resolve() for path in (kit, calibration, after, judged) if path is not None}
    if given & {path.resolve() for path in outputs}:
        raise InputError("an output is one of the inputs", expected="another file", file=outputs[0])
    if judged is not None:
        table = load_measurements(plan_file(judged), loaded, plan=True)
        reader = instrument_named(instrument)
        with progress() as say:
            say("judging", 0.0)
            told = judge(table, loaded, instrument=reader, expected=errors, known=own.known, tool_length_mm=tool_length)
        seconds = duration(loaded, own, table)
        echo(f"{judged}: {len(table)} readings with {instrument}, {seconds / 60.0:.0f} minutes by the kit's times\n")
        echo("\n".join([*(f"expected errors: {text}" for text in texts(errors.warnings)), told.to_text()]), end="")
        report = {"schema": "twin.plan/1", "judged": str(judged), "minutes": seconds / 60.0, "forecast": told.to_dict()}
        report["warnings"] = to_json(errors.warnings)
        incomplete = bool(table.set_aside)
        for text in grouped_notes(table.set_aside):
            echo(f"  set aside, {text}")
    else:
        with progress() as say:
            if causes is not None:
                made = separate(
                    loaded,
                    *causes,
                    own,
                    minutes=MINUTES_TO_SEPARATE if minutes is None else minutes,
                    calibration=errors,
                    after=None if after is None else load_measurements(after, loaded),
                    seed=seed,
                    say=say,
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
                    say=say,
                )
        report = made.to_dict()
        incomplete = not made.complete
        if output is not None:
            made.save(output)
        echo(made.to_text(), end="")
    if json_file is not None:
        write_json(json_file, report)
    if outputs:
        echo(f"\nwritten: {', '.join(str(path) for path in outputs)}")
    if incomplete:
        raise typer.Exit(NOT_ALL_MET)
