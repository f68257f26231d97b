"""Command ``twin demo``: one small example of everything, made by the documented commands alone."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, final

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError, OutputError
from twin._common.files import write_atomic
from twin.cli.shared import options
from twin.cli.shared.command import CommandResult, JsonOption, Output, command, progress_bar

HIDDEN: Final = ("reversal", "Y", {"size": 14.0})
"""The error that the simulated machine has and its calibration does not: backlash, µm."""
INDEX: Final = "index.html"
TODAY: Final = "machine_today.yaml"


@final
@dataclass(frozen=True)
class ExampleStep:
    """One command of the example: its words, what it is for, and the files to look at."""

    question: str
    words: str
    files: tuple[str, ...]
    printed: str = ""


STEPS: Final = (
    ExampleStep(
        "A program that cuts on this machine what was programmed",
        "compensate cone_frustum.nc -o compensated.nc --tool-length 120 --report compensated.txt --json compensated.json",
        ("compensated.nc", "compensated.txt"),
    ),
    ExampleStep(
        "The machine that runs it, and its error along the path",
        "scene cone_frustum.nc -o scene.html --tool-length 120",
        ("scene.html",),
    ),
    ExampleStep(
        "A measurement of the machine, which by now has an error that its calibration does not know",
        "simulate thesis_plan.csv -o measured.csv --calibration machine_today.yaml --seed 7",
        ("measured.csv", "machine_today.yaml"),
    ),
    ExampleStep(
        "What is wrong with the model?",
        "diagnose measured.csv --html diagnosis.html --json diagnosis.json --extended extended.yaml",
        ("diagnosis.html", "extended.yaml"),
    ),
    ExampleStep(
        "A second measurement, which the diagnosis never saw",
        "simulate thesis_plan.csv -o later.csv --calibration machine_today.yaml --seed 8",
        ("later.csv",),
    ),
    ExampleStep(
        "Does the extended model agree with it?",
        "diagnose later.csv --calibration extended.yaml --html later.html --json later.json",
        ("later.html",),
    ),
    ExampleStep(
        "The program again, for the machine of today",
        "compensate cone_frustum.nc -o compensated_again.nc --calibration extended.yaml --tool-length 120 --report again.txt",
        ("compensated_again.nc", "again.txt"),
    ),
    ExampleStep(
        "The state of the machine, for those who decide",
        "report --calibration extended.yaml --tool-length 120 -o report.html",
        ("report.html",),
    ),
)


@command("twin demo", "twin demo -o first_look")
def demo(
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="Folder to write; one of an earlier demo is replaced."),
        Output(folder=True),
    ] = Path("twin-demo"),
    json_file: JsonOption = None,
) -> CommandResult:
    """Run a small example of everything: a program, a measurement with a hidden error, its diagnosis, and a page that links them.

    Everything is simulated on the illustrative machine. Every step is a command of the manual, which the page shows.
    """
    own = {INDEX, TODAY, *(word for step in STEPS for word in step.words.split())}
    if output.exists() and (not output.is_dir() or any(path.name not in own for path in output.iterdir())):
        raise InputError("already exists", expected="the name of a new folder, or of an earlier demo", file=output)
    output.absolute().parent.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f".{output.name}.", dir=output.absolute().parent))
    try:
        done: list[ExampleStep] = []
        with progress_bar() as bar:
            _write_machine_of_today(folder)
            for i, step in enumerate(STEPS):
                bar(step.words.split()[0], i / len(STEPS))
                done.append(_run(step, folder))
        write_atomic(folder / INDEX, _page(folder, done))
        if output.exists():
            shutil.rmtree(output)
        folder.chmod(0o755)
        os.replace(folder, output)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    steps = [{"command": f"twin {step.words}", "files": list(step.files)} for step in STEPS]
    report = {"schema": "twin.demo/1", "page": str(output / INDEX), "steps": steps}
    return CommandResult(f"open {output / INDEX} in a browser", lambda: report, written=None)


def _write_machine_of_today(folder: Path) -> None:
    """Write the calibration of the simulated machine: the bundled one, and the hidden error as a third party would add it by hand."""
    calibration = options.machine(DEFAULT).default_calibration
    if calibration is None:
        raise OutputError(f"the bundled machine {DEFAULT} names no calibration")
    effect, where, numbers = HIDDEN
    added = f"effects:\n- effect: {effect}\n  where: {where}\n  parameters: {json.dumps(numbers)}\n"
    write_atomic(folder / TODAY, calibration.read_text(encoding="utf-8").rstrip() + "\n" + added)


def _run(step: ExampleStep, folder: Path) -> ExampleStep:
    """Run the command of a step in the folder, as its user would; raise `OutputError` with what it printed if it fails."""
    words = [sys.executable, "-m", "twin.cli", *step.words.split()]
    ran = subprocess.run(words, cwd=folder, capture_output=True, text=True, encoding="utf-8", check=False)
    if ran.returncode != 0:
        raise OutputError(f"twin {step.words}: exit status {ran.returncode}: {ran.stderr.strip()}")
    return ExampleStep(step.question, step.words, step.files, ran.stdout.strip())


def _page(folder: Path, steps: list[ExampleStep]) -> str:
    from twin.display import measured, render

    def result(name: str) -> Any:
        return json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))

    compensated, found, later = result("compensated"), result("diagnosis"), result("later")
    effect, where, numbers = HIDDEN
    return render(
        "cli/templates/demo.html.j2",
        title="twin: a first look",
        steps=steps,
        before=compensated["before"],
        after=compensated["after"],
        found=found,
        later=later,
        measured=measured,
        hidden=f"{effect} {where}, {next(iter(numbers.values())):g} µm",
    )
