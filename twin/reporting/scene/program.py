"""Animate a program from a script or a notebook in one call."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

from twin._common.bundled import find_program
from twin._common.errors import InputError
from twin._common.files import write_atomic
from twin._common.progress import Progress, silent
from twin.compensation.execute import Execution, execute_file
from twin.compensation.toolpath import Setup
from twin.display import in_iframe
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.conditions import Conditions
from twin.machine.machine import Machine
from twin.reporting.scene.draw import scene_html
from twin.reporting.scene.path import ScenePath

HEIGHT_PX: Final = 600
"""Height of the frame in a notebook."""


@final
@dataclass(frozen=True)
class Scene:
    """Animation of a machine running a program; displayed by a notebook.

    Attributes:
        html: the self-contained page.
        execution: the simulated execution that it shows.
    """

    html: str
    execution: Execution

    def save(self, path: str | Path) -> None:
        """Write the page atomically."""
        write_atomic(Path(path), self.html)

    def _repr_html_(self) -> str:
        return in_iframe(self.html, HEIGHT_PX).text


def draw_program(
    program: str | Path,
    machine: Machine,
    calibration: Calibration | None = None,
    *,
    tool_length_mm: float | None = None,
    tcp: bool = False,
    setup: Setup | None = None,
    conditions: Conditions | None = None,
    exaggeration: float | None = None,
    progress: Progress = silent,
) -> Scene:
    """Return the animation of a machine running an NC program.

    Args:
        program: path of the program, or the name of a bundled one.
        machine: the machine it runs on.
        calibration: the machine's errors; the machine file's own if None.
        tool_length_mm: the machine file's own if None.
        tcp: whether tool centre point control (RTCP) is active from the start.
        setup: work offsets and origin; none if None.
        conditions: temperatures and time, for the effects that need them.
        exaggeration: factor of the drawn deviation; None chooses a round number.
        progress: callback, called with stage and completed fraction.

    Raises:
        InputError: as `twin.compensation.execute.execute_file`; no motion within the axis ranges.
    """
    errors = Calibration.default(machine) if calibration is None else calibration
    progress("running", 0.0)
    run = execute_file(
        program, machine, errors, tool_length_mm=tool_length_mm, tcp=tcp, setup=setup, conditions=conditions
    )
    source = find_program(program)
    if len(run.positions) < 2:
        raise InputError("no motion within the axis ranges", expected="a program with motion", file=source)
    progress("drawing", 0.5)
    page = scene_html(
        Kinematics(machine, errors, tool_length_mm=tool_length_mm, conditions=conditions),
        ScenePath(run.positions, run.meant_mm, run.reached_mm, run.cutting, run.lines, run.gaps),
        title=source.name,
        exaggeration=exaggeration,
        warnings=errors.warnings,
        omitted=run.omitted,
    )
    return Scene(page, run)
