"""Command ``twin volume``."""

from __future__ import annotations

from time import monotonic
from typing import TYPE_CHECKING, Annotated

import typer

from twin._common.bundled import DEFAULT, TRIALS, VOLUME_POSES
from twin._common.provenance import warning_texts
from twin.cli.shared import options
from twin.cli.shared.command import CommandResult, JsonOption, command, progress_bar

if TYPE_CHECKING:
    from twin.tool.population import Population, Spread


@command(
    "twin volume --calibration mine.yaml --tool-length 120 --trials 1000000 --seed 1",
    "twin volume -c mine.yaml --workers 2 --json volume.json",
)
def volume(
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    trials: Annotated[int, typer.Option("--trials", help="Number of machines drawn.")] = TRIALS,
    poses: Annotated[
        int, typer.Option("--poses", help="Number of poses over the volume, the same for all machines.")
    ] = VOLUME_POSES,
    seed: Annotated[int, typer.Option("--seed", help="Random seed.")] = 0,
    digits: Annotated[
        int,
        typer.Option(
            "--digits",
            min=1,
            max=2,
            help="Significant digits of u to which first order must agree; 2 needs 1,000,000 machines.",
        ),
    ] = 1,
    tool_length: options.ToolOption = None,
    temperature: options.TemperatureOption = None,
    time: options.TimeOption = None,
    rpm: options.RpmOption = None,
    load: options.LoadOption = None,
    workers: options.WorkersOption = None,
    scheduler: options.SchedulerOption = None,
    tls_ca: options.TlsCaOption = None,
    tls_cert: options.TlsCertOption = None,
    tls_key: options.TlsKeyOption = None,
    json_file: JsonOption = None,
) -> CommandResult:
    """Draw machines from the calibration's covariance and evaluate their errors over the volume (Monte Carlo).

    The same seed gives bit-identical numbers on any number of workers, local or on a Dask cluster (--scheduler).
    """
    from twin.tool.forward import Kinematics
    from twin.tool.population import draw_machines

    loaded = options.machine(machine)
    errors = options.calibration_of(calibration, loaded)
    at = options.conditions(temperature, time, rpm, load)
    kinematics = Kinematics(loaded, errors, tool_length_mm=tool_length, conditions=at)
    own = options.workers(workers, scheduler, tls_ca, tls_cert, tls_key)
    began = monotonic()
    with progress_bar() as bar:

        def report_rate(stage: str, fraction: float) -> None:
            rate = fraction * trials * poses / (monotonic() - began)
            bar(f"{rate / 1e6:.1f} million poses/s" if fraction else stage, fraction)

        population = draw_machines(
            kinematics, trials=trials, poses=poses, seed=seed, digits=digits, workers=own, progress=report_rate
        )
    taken = monotonic() - began
    millions = population.machines * len(population.positions) / 1e6
    lines = [
        f"{population.machines} machines drawn for {loaded.name} from {errors.path} with seed {seed}",
        *warning_texts(population.warnings),
        f"at {len(population.positions)} poses over the volume, tool length {kinematics.tool_length_mm:g} mm: "
        f"{millions:.1f} million poses in {taken:.1f} s, {millions / taken:.1f} million a second\n",
        *_lines(population, programs=loaded.runs_programs),
        *options.unused(at, errors),
    ]
    return CommandResult("\n".join([*lines, ""]), population.to_dict)


def _lines(found: Population, *, programs: bool) -> list[str]:
    values = found.to_dict()
    drawn, first = values["by_draws"], values["first_order"]
    place = ", ".join(f"{name} {round(value)}" for name, value in found.where.items())
    enough = values["first_order_enough"]
    least = "at least " if found.without_uncertainty else ""
    lines = [
        "U of the tool point: radius around the estimate that contains 95 % of the draws; first order assumes a normal distribution",
        f"                RMS over the poses      largest{' (' + least.strip() + ')' if least else ''}",
        f"  by draws      {drawn['rms_um']:12.3f} µm {drawn['max_um']:15.3f} µm   at {place}",
        f"  first order   {first['rms_um']:12.3f} µm {first['max_um']:15.3f} µm",
        f"  first order agrees with the draws (JCGM 101, 8) at {enough['yes']} poses, not at {enough['no']}"
        + (f"; too few draws to decide at {enough['too_few_draws']}" if enough["too_few_draws"] else ""),
        "",
        "error over the volume, per machine             mean     95 % interval          largest drawn",
        _row("uncompensated: RMS over the poses", found.as_it_is[0]),
        _row("          largest of the poses", found.as_it_is[1]),
        _row(f"{'compensated with' if programs else 'minus'} this calibration: RMS", found.compensated[0]),
        _row("          largest of the poses", found.compensated[1]),
    ]
    if found.not_identified:
        known = values["first_order_identified_errors"]
        lines.append(
            f"drawn from their plausible size, because not identified: {', '.join(found.not_identified)}; without them U to "
            f"first order is {known['rms_um']:.3f} µm RMS, {known['max_um']:.3f} µm largest"
        )
    if found.without_uncertainty:
        names = ", ".join(found.without_uncertainty)
        lines.append(f"not varied (no covariance in the calibration): {names}")
    return lines


def _row(name: str, spread: Spread) -> str:
    return f"  {name:<38}{spread.mean:10.3f}   {spread.low:8.3f} … {spread.high:8.3f}   {spread.largest:10.3f} µm"
