"""The command line: arguments in, files and one account of them out. The only place that prints."""

from __future__ import annotations

import fnmatch
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from twin.budget import BudgetRow, error_budget, known_at
from twin.calibration import Calibration
from twin.channels import Conditions, options_of
from twin.compensation import Compensator, Options
from twin.diagnosis import diagnose as run_diagnosis
from twin.errors import InputError, OutputError
from twin.execute import execute
from twin.files import check_writable, write_whole
from twin.identification import identify as run_identification
from twin.instruments import INSTRUMENTS
from twin.inverse import DEFAULT_ROTARY_LIMIT_DEG
from twin.iso16907 import NAMES, Scope
from twin.kinematics import Kinematics
from twin.machine import Machine
from twin.measurement import load as load_measurements
from twin.nc import dialect_for, find_program, read_program
from twin.options import conditions, gathered, instrument_named, plan_file, positive, setup, surroundings
from twin.simulate import simulate as run_simulation
from twin.toolpath import WordSpace, follow
from twin.uncertainty import DEFINITION, ToolUncertainty

BAD_INPUT = 2
NOT_ALL_MET = 3
INTERRUPTED = 130

app = typer.Typer(
    help="A digital twin of a five-axis machine tool that finds out, from measurements, where its own model is wrong.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
)


class Mode(StrEnum):
    """Who does the kinematics."""

    axis = "axis"
    tcp = "tcp"


class Method(StrEnum):
    """How commands are found."""

    exact = "exact"
    thesis = "thesis"


class Scatter(StrEnum):
    """Whose scatter an uncertainty carries."""

    stated = "stated"
    repeats = "repeats"
    between_poses = "between poses"
    between_rounds = "between rounds"


MachineOption = Annotated[
    str, typer.Option("--machine", "-m", help="Machine file, or the name of one that comes with twin.")
]
CalibrationOption = Annotated[
    Path | None, typer.Option("--calibration", "-c", help="Calibration file; the machine file's own if not given.")
]
ToolOption = Annotated[float | None, typer.Option("--tool-length", help="mm from spindle nose to tool tip.")]
OffsetOption = Annotated[
    list[str] | None, typer.Option("--work-offset", help="Added to axis words: X=… Y=… Z=… B=… C=… (mm, degrees).")
]
OriginOption = Annotated[
    str | None, typer.Option("--work-origin", help="x,y,z of the program's zero in the work frame (mm), in mode tcp.")
]
ModeOption = Annotated[Mode, typer.Option("--mode", help="axis: words are axis positions; tcp: tool-tip coordinates.")]
TemperatureOption = Annotated[
    list[str] | None,
    typer.Option(
        "--temperature",
        help="°C of an axis's scale or of a sensor, over the whole program: X=23.1 bed=21.",
    ),
]
TimeOption = Annotated[
    float | None,
    typer.Option(
        "--time",
        help="For a warm-up: seconds on the clock of the measured table's time_s, which starts with the cold machine; held over "
        "the whole program, so take its middle. A machine warmed through: a large number.",
    ),
]
JsonOption = Annotated[Path | None, typer.Option("--json", help="Write the report as JSON.")]


@app.command()
def info(
    machine: MachineOption = "dmu50",
    calibration: CalibrationOption = None,
    tool_length: ToolOption = None,
    temperature: TemperatureOption = None,
    time: TimeOption = None,
) -> None:
    """Axes, ranges, frames and the error budget of a machine."""
    loaded = Machine.load(machine)
    errors = _calibration(calibration, loaded)
    at = conditions(temperature, time)
    at.check(errors)
    console = Console()
    console.print(f"[bold]{loaded.name}[/bold]   twin {version('twin')}")
    console.print(
        f"machine file  {loaded.path}\nURDF          {loaded.urdf}\ncalibration   {errors.path or 'none'}\n{errors.source}\n",
        highlight=False,
    )
    axes = Table(
        "axis",
        "kind",
        "range",
        "least increment",
        "side",
        "joint",
        title="Axes, in command order",
        title_justify="left",
    )
    for axis in loaded.axes:
        span = "unlimited" if axis.lower is None else f"{axis.lower:g} … {axis.upper:g} {axis.unit}"
        axes.add_row(
            axis.name,
            "linear" if axis.linear else "rotary",
            span,
            f"{axis.increment:g} {axis.unit}",
            axis.side,
            axis.joint,
        )
    console.print(axes)
    frames = Table("frame", "of axis", "components", title="Error frames", title_justify="left")
    for frame in loaded.frames:
        frames.add_row(
            "error motion" if frame.role == "motion" else "location", frame.axis, " ".join(loaded.error_names(frame))
        )
    console.print(frames)
    console.print(
        f"tool frame {loaded.model.frames[loaded.tool_frame].name}, work frame {loaded.model.frames[loaded.work_frame].name}, "
        f"squareness {' '.join(loaded.squareness_names) or 'none'}, locations {' '.join(loaded.location_names) or 'none'}\n",
        highlight=False,
    )
    known, missing = known_at(at, errors)
    rows, classes = error_budget(loaded, known, tool_length_mm=tool_length, conditions=at)
    length = loaded.tool_length_mm if tool_length is None else tool_length
    console.print(
        _budget_table(f"Error budget at the tool over the volume, tool length {length:g} mm", rows, peak=True)
    )
    console.print(_budget_table("By class (ISO/TR 16907)", classes, peak=False))
    if any(row.illustrative for row in rows):
        console.print("* illustrative: drawn, not measured")
    if any(row.name.startswith("reversal:") for row in rows):
        console.print("a reversal counts as ± half its size", highlight=False)
    if at.channels:
        console.print(
            f"taken at: {', '.join(f'{name} {value:g}' for name, value in at.channels.items())}", highlight=False
        )
    _tell_unused(at, errors)
    for channel, effects in missing.items():
        console.print(f"left out: {', '.join(effects)} (needs {options_of([channel])})", highlight=False)
    for line in _uncertainty_lines(Kinematics(loaded, known, tool_length_mm=tool_length, conditions=at)):
        console.print(line, highlight=False, soft_wrap=True)


@app.command()
def compensate(
    program: Annotated[
        Path, typer.Argument(help="NC program: ISO, Heidenhain .h, APT .cls; or one that comes with twin.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The compensated program.")],
    machine: MachineOption = "dmu50",
    calibration: CalibrationOption = None,
    scope: Annotated[
        list[str] | None, typer.Option("--scope", help=f"ISO/TR 16907 classes: {' '.join(NAMES)}.")
    ] = None,
    mode: ModeOption = Mode.axis,
    tolerance: Annotated[
        float, typer.Option("--tolerance", help="mm of error allowed between the ends of a block.")
    ] = 1e-3,
    json_file: JsonOption = None,
    report_file: Annotated[Path | None, typer.Option("--report", help="Write the report as text, too.")] = None,
    tool_length: ToolOption = None,
    work_offset: OffsetOption = None,
    work_origin: OriginOption = None,
    method: Annotated[
        Method, typer.Option("--method", help="exact: the inverse with errors; thesis: the baseline.")
    ] = Method.exact,
    rotary_limit: Annotated[
        float, typer.Option("--rotary-limit", help="Degrees a rotary axis may move to repair an orientation.")
    ] = DEFAULT_ROTARY_LIMIT_DEG,
    temperature: TemperatureOption = None,
    time: TimeOption = None,
) -> None:
    """Write the program whose execution on the machine with errors lands where the given one meant.

    twin compensate part.nc -o part.compensated.nc --tool-length 120 --json report.json

    A calibration extended by twin diagnose may need more: temperatures (--temperature X=23.1 bed=21) and, for a warm-up, the time
    (--time). Reversals need nothing: the side each axis comes from follows from the program.
    """
    loaded = Machine.load(machine)
    source = find_program(program)
    positive("--tolerance", tolerance)
    positive("--rotary-limit", rotary_limit)
    read, dialect = read_program(source)
    target = dialect_for(output)
    if target.name != dialect.name and dialect.name != "apt":
        raise InputError(
            f"a {dialect.name} program cannot be written as {target.name}",
            expected=f"-o with {' '.join(dialect.suffixes)}",
            file=output,
        )
    outputs = [path for path in (output, json_file, report_file) if path is not None]
    check_writable(outputs)
    if source.resolve() in {path.resolve() for path in outputs}:
        raise InputError("the output is the program itself", expected="another file", file=output)
    options = Options(
        setup=setup(loaded, work_offset, work_origin),
        tool_length_mm=tool_length,
        tcp=mode is Mode.tcp,
        scope=None if scope is None else Scope.parse(scope),
        tolerance_mm=tolerance,
        rotary_limit_deg=rotary_limit,
        method=method.value,
        conditions=conditions(temperature, time),
    )
    compensator = Compensator(loaded, _calibration(calibration, loaded), options)
    with _progress() as say:
        result = compensator.compensate(read, dialect, say, into=target)
    account = result.report.to_text()
    write_whole(output, result.text.encode("latin-1"))
    if json_file is not None:
        write_whole(json_file, json.dumps(result.report.to_dict(), indent=1) + "\n")
    if report_file is not None:
        write_whole(report_file, account)
    print(account, end="")
    print(f"\nwritten: {', '.join(str(path) for path in outputs)}")
    if not result.report.complete:
        raise typer.Exit(NOT_ALL_MET)


@app.command()
def scene(
    program: Annotated[Path, typer.Argument(help="NC program, or one that comes with twin.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The scene: one HTML file.")],
    machine: MachineOption = "dmu50",
    calibration: CalibrationOption = None,
    mode: ModeOption = Mode.axis,
    tool_length: ToolOption = None,
    work_offset: OffsetOption = None,
    work_origin: OriginOption = None,
    exaggeration: Annotated[float | None, typer.Option("--exaggeration", help="Factor on the drawn deviation.")] = None,
    temperature: TemperatureOption = None,
    time: TimeOption = None,
) -> None:
    """Draw the machine running a program: meant and actual tool path, in one HTML file that needs no network.

    twin scene part.nc -o scene.html --tool-length 120
    """
    from twin.scene import ScenePath, scene_html  # meshcat takes its time, and only this command needs it

    loaded = Machine.load(machine)
    source = find_program(program)
    read, dialect = read_program(source)
    check_writable([output])
    if exaggeration is not None:
        positive("--exaggeration", exaggeration)
    errors = _calibration(calibration, loaded)
    at = conditions(temperature, time)
    at.require(errors)
    real = Kinematics(loaded, errors, tool_length_mm=tool_length, conditions=at)
    space = WordSpace(loaded, setup(loaded, work_offset, work_origin), tool_length)
    with _progress() as say:
        say("reading", 0.0)
        path = follow(read, dialect.moves(read, space.axes, tcp=mode is Mode.tcp), space)
        say("running", 0.2)
        run = execute(read, path, space, real)
        if len(run.positions) < 2:
            raise InputError(
                "nothing to draw: no motion within the machine's ranges", expected="a program with motion", file=source
            )
        say("drawing", 0.5)
        drawn = ScenePath(run.positions, run.meant_mm, run.reached_mm, run.cutting, run.lines)
        html = scene_html(
            real,
            drawn,
            title=f"{source.name} on {loaded.name}",
            exaggeration=exaggeration,
            illustrative=errors.illustrative,
        )
    write_whole(output, html)
    left = f" ({run.left_out} points outside the ranges left out)" if run.left_out else ""
    print(f"written: {output}{left}")
    _tell_unused(at, errors)
    if run.left_out:
        raise typer.Exit(NOT_ALL_MET)


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
    truth = _calibration(calibration, loaded)
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


@app.command()
def identify(
    measured: Annotated[Path, typer.Argument(help="The measurement table.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The calibration.")],
    machine: MachineOption = "dmu50",
    instrument: Annotated[
        str | None,
        typer.Option(
            "--instrument",
            help=f"{', '.join(one.name for one in INSTRUMENTS)}; if not given: interferometer if only lengths were read, else tracker.",
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
        list[str] | None, typer.Option("--only", help="Errors to seek, by name; * for any letter: E_*X E_C0Y E_*0C.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Identify error motions, squareness and axis locations from measured points, with their uncertainty.

    twin identify measured.csv -o mine.yaml --json report.json
    """
    loaded = Machine.load(machine)
    check_writable([path for path in (output, json_file) if path is not None])
    if measured.resolve() in {path.resolve() for path in (output, json_file) if path is not None}:
        raise InputError("the output is the measurement itself", expected="another file", file=output)
    names = (*loaded.motion_names, *loaded.squareness_names, *loaded.location_names)
    for pattern in only or []:
        if not fnmatch.filter(names, pattern):
            raise InputError(
                "--only names no error of this machine", expected=f"among {', '.join(names)}", value=pattern
            )
    with _progress() as say:
        say("reading", 0.0)
        data = load_measurements(measured, loaded)
        found = run_identification(
            data,
            loaded,
            instrument=None if instrument is None else instrument_named(instrument),
            wanted=lambda name: only is None or any(fnmatch.fnmatchcase(name, pattern) for pattern in only),
            spread=spread.value,
            say=say,
        )
    found.calibration.save(output)
    if json_file is not None:
        write_whole(json_file, json.dumps(found.to_dict(), indent=1) + "\n")
    print(found.to_text(), end="")
    print(f"\nwritten: {', '.join(str(path) for path in (output, json_file) if path is not None)}")
    if not found.complete:
        raise typer.Exit(NOT_ALL_MET)


@app.command()
def diagnose(
    measured: Annotated[Path, typer.Argument(help="The measurement table.")],
    machine: MachineOption = "dmu50",
    calibration: CalibrationOption = None,
    instrument: Annotated[
        str | None,
        typer.Option(
            "--instrument", help="Whose scatter to take; if not given: the table's uncertainties, else the repeats'."
        ),
    ] = None,
    json_file: JsonOption = None,
    html_file: Annotated[Path | None, typer.Option("--html", help="Write the report as one HTML file.")] = None,
    extended: Annotated[
        Path | None, typer.Option("--extended", help="Write the calibration with what was found of the machine.")
    ] = None,
) -> None:
    """Show what the model gets wrong about measured data, and name the cause.

    twin diagnose measured.csv --calibration mine.yaml --json diagnosis.json --extended better.yaml
    """
    loaded = Machine.load(machine)
    outputs = [path for path in (json_file, html_file, extended) if path is not None]
    check_writable(outputs)
    inputs = {path.resolve() for path in (measured, calibration) if path is not None}
    if inputs & {path.resolve() for path in outputs}:
        raise InputError("an output is one of the inputs", expected="another file", file=outputs[0])
    errors = _calibration(calibration, loaded)
    with _progress() as say:
        say("reading", 0.0)
        data = load_measurements(measured, loaded)
        reader = None if instrument is None else instrument_named(instrument)
        found = run_diagnosis(data, loaded, errors, instrument=reader, say=say)
    if extended is not None:
        found.extended.save(extended)
    if json_file is not None:
        write_whole(json_file, json.dumps(found.to_dict(), indent=1) + "\n")
    if html_file is not None:
        from twin.diagnosis.report import diagnosis_html  # matplotlib takes its time, and only this option needs it

        write_whole(html_file, diagnosis_html(found))
    print(found.to_text(), end="")
    if outputs:
        print(f"\nwritten: {', '.join(str(path) for path in outputs)}")
    if found.data.set_aside:
        raise typer.Exit(NOT_ALL_MET)


def main(arguments: list[str] | None = None) -> None:
    """Entry point: exit 0 done, 2 bad input or usage, 3 done but something could not be met, all of it listed."""
    try:
        app(args=gathered(sys.argv[1:] if arguments is None else arguments), standalone_mode=True)
    except InputError as error:
        print(f"twin: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    except OutputError as error:
        print(f"twin: defect, nothing written: {error}", file=sys.stderr)
        sys.exit(NOT_ALL_MET)
    except KeyboardInterrupt:
        print("twin: interrupted, nothing written", file=sys.stderr)
        sys.exit(INTERRUPTED)


def _tell_unused(at: Conditions, errors: Calibration) -> None:
    for name in at.unused(errors):
        print(f"{name} was given and the calibration does not need it")


def _calibration(path: Path | None, machine: Machine) -> Calibration:
    return Calibration.default(machine) if path is None else Calibration.load(path, machine)


def _uncertainty_lines(kinematics: Kinematics) -> list[str]:
    """What is known of the tool point over the volume, and what is not."""
    if kinematics.calibration.empty:
        return []
    found = ToolUncertainty(kinematics)
    missing = ", ".join(found.without_uncertainty)
    if not found.parameters:
        return ["uncertainty of the tool point: unknown (no covariance in the calibration)"]
    over = found.over_volume()
    place = ", ".join(f"{name} {round(value)}" for name, value in over.where.items())
    least = "at least " if missing else ""
    lines = [
        f"uncertainty of the tool point over the volume: U {least}{over.rms_um:.2f} µm RMS, {over.max_um:.2f} µm largest "
        f"(at {place}) over {len(over.positions)} poses; {DEFINITION}"
    ]
    return [*lines, f"not in it (no covariance in the calibration): {missing}"] if missing else lines


def _budget_table(title: str, rows: tuple[BudgetRow, ...], *, peak: bool) -> Table:
    known = any(np.isfinite(row.peak_u) for row in rows)
    headers = ["error", "class", "peak", *(["peak u (k = 1)"] if known else [])] if peak else ["class"]
    table = Table(*headers, "tool RMS", "tool max", title=title, title_justify="left")
    for row in rows:
        unit = "µm" if row.unit == "um" else "µrad"
        start = (
            [row.name + ("*" if row.illustrative and peak else ""), row.iso_class, f"{row.peak:.1f} {unit}"]
            if peak
            else [row.name]
        )
        if peak and known:
            start.append(f"{row.peak_u:.2f} {unit}" if np.isfinite(row.peak_u) else "unknown")
        table.add_row(*start, f"{row.tool_rms_um:.2f} µm", f"{row.tool_max_um:.2f} µm")
    return table


@contextmanager
def _progress() -> Iterator[Any]:
    """One line on stderr while it lasts; nothing where nobody watches."""
    console = Console(stderr=True)
    with Progress(
        TextColumn("{task.description:>10}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda stage, fraction: bar.update(task, description=stage, completed=fraction)


if __name__ == "__main__":
    main()
