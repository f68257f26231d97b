"""Simulated execution of a program on the machine with errors: nominal and real tool poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.units import count_with_noun
from twin.compensation.programs.backlash import Backlash
from twin.compensation.programs.block_conditions import CONSTANT, BlockConditions, block_conditions
from twin.compensation.programs.follow import SectionMotions, follow_sections
from twin.compensation.programs.motions import (
    CHORD_MM,
    SAMPLES_A_PIECE,
    LostBlock,
    ToolPath,
    by_reason,
    counted,
    machine_hints,
)
from twin.compensation.programs.pieces import check_one_mode
from twin.compensation.programs.words import Setup, WordSpace, check_domains, outside_range
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.nc import read_program
from twin.nc.blocks import Program
from twin.nc.dialect import Dialect
from twin.nc.inline import errors_in_files
from twin.tool.forward import Kinematics

SAME_POSITION: Final = 1e-6
"""Largest difference of an axis between two conversions of one position, mm or degrees."""


@final
@dataclass(frozen=True, repr=False)
class Execution(Result):
    """Result of executing a program once.

    Attributes:
        positions: (n, axes) commands, mm and degrees, command order.
        meant_mm: (n, 3) nominal tool points in the work frame.
        sides: (n, axes) approach directions, as in `twin.compensation.programs.backlash`.
        reached_mm: (n, 3) real tool points.
        tilt_urad: (n, 2) tilt of the tool axis from its nominal direction (`Poses.tilt_urad`).
        cutting: (n,) False on rapids.
        ends: (n,) whether the point is the end point of a block.
        lines: (n,) program line of each point.
        gaps: (n,) whether the way from the point before is unknown or left out; True at the first point.
        tools: (n,) number or name of the tool in the spindle; empty if the program's tools are not followed.
        lengths_mm: (n,) its length.
        left_out: number of points outside an axis's range, for which no errors are known.
        unknown: blocks left out because their places are unknown.
        zeros_mm: (k, 3) places of the program's zero in the work frame while it cuts; one unless work offsets or tool lengths move it.
    """

    positions: np.ndarray
    meant_mm: np.ndarray
    sides: np.ndarray
    reached_mm: np.ndarray
    tilt_urad: np.ndarray
    cutting: np.ndarray
    ends: np.ndarray
    lines: np.ndarray
    gaps: np.ndarray
    tools: np.ndarray
    lengths_mm: np.ndarray
    left_out: int
    unknown: tuple[LostBlock, ...] = ()
    zeros_mm: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def complete(self) -> bool:
        """Whether every point and every cutting block is executed."""
        return not self.left_out and not any(one.cutting for one in self.unknown)

    @property
    def omitted(self) -> str:
        """Parts left out, in words; empty if there are none."""
        points = f"{count_with_noun(self.left_out, 'point')} outside the axis ranges" if self.left_out else ""
        blocks = [
            f"{count_with_noun(len(moves), 'block')} from line {moves[0].line + 1} on ({reason})"
            for reason, moves in by_reason(self.unknown).items()
        ]
        return "; ".join([*([points] if points else []), *blocks])

    @property
    def brief(self) -> str:
        """Error of the tool point."""
        off = np.linalg.norm(self.reached_mm - self.meant_mm, axis=1) * 1e3
        if not len(off):
            return "no point within the axis ranges"
        worst = int(np.argmax(off))
        error = f"{np.sqrt(np.mean(off**2)):.2f} µm RMS, {off[worst]:.2f} µm largest (line {self.lines[worst]})"
        left_out = f"; left out: {self.omitted}" if self.omitted else ""
        return f"{count_with_noun(len(off), 'point')}: error of the tool point {error}{left_out}"


def execute_file(
    program: str | Path,
    machine: Machine,
    calibration: Calibration | None = None,
    *,
    tool_length_mm: float | None = None,
    tcp: bool = False,
    setup: Setup | None = None,
    conditions: Conditions | None = None,
    language: str | None = None,
) -> Execution:
    """Execute the program of a file, or a sample program of twin.

    Args:
        program: its path.
        machine: the machine it runs on.
        calibration: the machine's errors; the machine file's own if None.
        tool_length_mm: the machine file's own if None.
        tcp: whether tool-centre-point mode is on from the start.
        setup: work offsets and origin; none if None.
        conditions: temperatures, time and speed, for the effects that need them.
        language: as for `twin.read_program`.

    Raises:
        InputError: as for `execute`; the program cannot be read, or moves no axis to a known position; an effect needs a
            temperature or time that is not given.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> execution = twin.execute_file("cone_frustum.nc", machine, tool_length_mm=120)
        >>> error_um = 1e3 * np.linalg.norm(execution.reached_mm - execution.meant_mm, axis=1)
        >>> round(float(error_um.max()), 1)
        83.6
    """
    read, dialect = read_program(program, language)
    options = Setup() if setup is None else setup, tool_length_mm
    return execute_program(read, dialect, machine, calibration, options, tcp=tcp, conditions=conditions)


def execute_program(
    read: Program,
    dialect: Dialect,
    machine: Machine,
    calibration: Calibration | None,
    used: tuple[Setup, float | None],
    *,
    tcp: bool = False,
    conditions: Conditions | None = None,
) -> Execution:
    """Execute a program that has been read; ``used``: set-up and tool length; otherwise as `execute_file`."""
    errors = Calibration.given(machine, calibration)
    errors = errors.with_transformation() if tcp else errors
    at = Conditions() if conditions is None else conditions
    at.require(errors)
    space = WordSpace(machine, *used)
    with errors_in_files(read), machine_hints(machine, dialect, lambda line: "".join(read.texts[line - 1 : line])):
        reading = dialect.moves(read, space.axes, tcp=tcp)
        _, path, parts = follow_sections(read, reading, space)
        check_one_mode(errors, path.columns.tcp, read.source, tcp=tcp)
        by_block = block_conditions(read, dialect, path, [(part.begin, part.space) for part in parts], errors, at)
        runs = []
        of_length: dict[float, Kinematics] = {}
        for part in parts:
            length = part.space.nominal.tool_length_mm
            if length not in of_length:
                of_length[length] = Kinematics(
                    machine, errors, tool_length_mm=length, conditions=at, by_pose=by_block.names
                )
            conditions_of = by_block.part(part.begin - part.context, part.end)
            run = execute(read, part.path, part.space, of_length[length], conditions_of, context=part.context)
            runs.append(replace(run, tools=np.full(len(run.lines), part.tool)))
    whole = runs[0] if len(runs) == 1 else _joined(runs)
    numbered = tuple(one._replace(line=int(read.numbers[one.line]) - 1) for one in path.unknown)
    return replace(whole, unknown=numbered, zeros_mm=_zeros(parts))


def _zeros(parts: Sequence[SectionMotions]) -> np.ndarray:
    """Return (k, 3) different places of the program's zero in the sections that cut: outside their tilted planes, rotary words zero."""
    found: list[np.ndarray] = []
    for part in {id(part.space): part for part in parts if not part.path.columns.rapid[part.context :].all()}.values():
        space, modes = part.space, np.unique(part.path.columns.tcp[part.context :])
        if space.tilt is not None:
            space, modes = WordSpace(space.machine, space.setup, space.tool_length_mm, like=space), np.array([False])
        words = np.zeros((len(modes), len(space.axes.names)))
        for place in space.nominal.forward(space.commands(words, modes)).point_mm:
            if not any(np.abs(place - other).max() < SAME_POSITION for other in found):
                found.append(place)
    return np.array(found).reshape(-1, 3)


def execute(
    program: Program,
    path: ToolPath,
    space: WordSpace,
    real: Kinematics,
    conditions: BlockConditions = CONSTANT,
    *,
    context: int = 0,
) -> Execution:
    """Execute a program as its control would: straight lines in words between blocks, also for rapids.

    ``context``: number of first motions that belong to the section before. `InputError` for a position within the axis's range that its
    error motions do not cover.
    """
    columns = path.columns
    of, fractions = _fractions(path)
    words = path.dense(of, fractions)
    ends, lines = np.append(of[1:] != of[:-1], True), columns.line[of] + 1
    positions = space.commands(words, columns.tcp[of])
    check_domains(real, program.source, lines[ends], positions[ends])
    sides = Backlash(real.calibration).sides(path, of, positions)
    state = conditions.at(sides, of, fractions)
    own = of >= context
    inside = ~outside_range(space.machine, positions) & ~real.outside_domain(positions).any(axis=1)
    gaps = _gaps(path, space, positions, ends) | ~np.append(True, inside[:-1])
    keep = own & inside
    positions, sides = positions[keep], sides[keep]
    nominal, reached = space.nominal.forward(positions), real.forward(positions, state[keep])
    return Execution(
        positions=positions,
        meant_mm=nominal.point_mm,
        sides=sides,
        reached_mm=reached.point_mm,
        tilt_urad=reached.tilt_urad(nominal),
        cutting=~columns.rapid[of][keep],
        ends=ends[keep],
        lines=program.numbers[lines[keep] - 1],
        gaps=gaps[keep],
        tools=np.full(len(positions), ""),
        lengths_mm=np.full(len(positions), space.nominal.tool_length_mm),
        left_out=int(np.count_nonzero(own & ~keep)),
    )


def _gaps(path: ToolPath, space: WordSpace, positions: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return (n,) whether a point is the first of a motion that does not begin where the one before ended."""
    begins = space.commands(path.columns.start, path.columns.tcp)
    distance = np.abs(begins[1:] - positions[ends][:-1]).max(axis=1)
    gaps = np.append(True, ends[:-1])
    gaps[gaps] = np.append(True, ~(distance <= SAME_POSITION))  # also where the start is not a number
    return gaps


def _joined(runs: Sequence[Execution]) -> Execution:
    """Return the executions of consecutive sections as one."""
    arrays = {
        one.name: np.concatenate([getattr(run, one.name) for run in runs])
        for one in fields(Execution)
        if one.name not in ("left_out", "unknown", "zeros_mm")
    }
    return Execution(**arrays, left_out=sum(run.left_out for run in runs), unknown=())


def _fractions(path: ToolPath) -> tuple[np.ndarray, np.ndarray]:
    """Return the motion of each sample and its fraction, those of `CompensationAccount`; only the end if the start is unknown."""
    columns = path.columns
    long = np.where(columns.known, np.maximum(SAMPLES_A_PIECE, columns.spacings), 0.0)
    for i, move in columns.special.items():
        if move.arc is not None and columns.known[i]:
            long[i] = max(long[i], path.motions[i].chords(CHORD_MM))
    inside = np.ceil(long).astype(int)
    of, k = counted(inside + 1)
    return of, np.where(k == inside[of], 1.0, (k + 0.5) / np.maximum(inside[of], 1))
