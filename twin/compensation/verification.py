"""A compensated program verified on a control: LinuxCNC executes it, and the error at the tool is evaluated over the whole motion.

The error of a sample is the distance of the tool point from the programmed path in the workpiece: the time at which the control gets
there does not matter. The control's own share is its distance from the path of the compensated program's words: corners that it rounds
(G64) within its acceleration, and blocks that it joins within its path tolerance (G64 P), the corrections among them. The compensated
program is executed once more on the exact path (G61): this is the share without G64, of acceleration and interpolation alone. Rapids
are not evaluated, but belong to the path.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import numpy as np
from scipy.spatial import cKDTree

from twin._common.bundled import DEFAULT_ACCELERATION
from twin._common.errors import InputError
from twin._common.provenance import warning_texts
from twin._common.records import json_form
from twin.compensation.programs.compensator import Compensator
from twin.compensation.programs.execute import execute
from twin.compensation.programs.follow import follow_sections
from twin.compensation.programs.prepared import PreparedMachine
from twin.compensation.programs.words import Setup
from twin.controls import linuxcnc
from twin.controls.offsets import parameter_file
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import read_program
from twin.nc.blocks import Program
from twin.nc.dialect import Dialect
from twin.tool.forward import Kinematics

SCHEMA: Final = "twin.verification/1"
LONGEST_S: Final = 3600.0
STEP_MM, STEP_DEG = 0.2, 0.05
"""Spacing of the programmed path in the axes: chords in the workpiece are then off by less than 0.01 µm per 100 mm of radius."""
_FEEDS: Final = (2, 3)
"""Types of motion that cut: lines and arcs at feed."""
_PATH_MODE: Final = re.compile(r"G\s*0*64(?![\d.])", re.IGNORECASE)
_PATH_TOLERANCE: Final = re.compile(r"[PQ]\s*[-+]?\s*(\[[^\]]*\]|#\s*(<[^>]*>|\d+)|[\d.]+)", re.IGNORECASE)
_COMMENT: Final = re.compile(r"(\([^)]*\)|;.*)")
ELSEWHERE_UM: Final = 500.0
"""Distance of the control on the exact path from the words of a program from which it has read other words."""


@final
@dataclass(frozen=True)
class PathDistance:
    """Error of the tool point over a motion."""

    median_um: float  # median_um, largest_um: distance from the programmed path
    largest_um: float
    line: int  # line, block: the line of the executed program at the largest one, and its text
    block: str


@final
@dataclass(frozen=True, repr=False)
class Verification(Result):
    """Result of executing a program and its compensated form on a control.

    Attributes:
        before: error of the original program on the machine with errors.
        after: error of the compensated one.
        control: distance of the compensated one from the path of its own words.
        exact: the same, executed on the exact path (G61).
        samples: number of samples, of the original and of the compensated program.
        acceleration: largest acceleration of the control, mm/s² and °/s².
        warnings: of the calibration.
    """

    program: str
    before: PathDistance
    after: PathDistance
    control: PathDistance
    exact: PathDistance
    samples: tuple[int, int]
    acceleration: float
    warnings: tuple[str, ...] = ()

    @property
    def brief(self) -> str:
        """Error before and after."""
        return f"verified on LinuxCNC: {self.before.largest_um:.2f} µm largest before, {self.after.largest_um:.2f} µm after"

    def to_text(self) -> str:
        """Return the report."""
        times = " and ".join(f"{count * linuxcnc.PERIOD_S:.1f} s" for count in self.samples)
        rows = (
            ("original program", self.before),
            ("compensated program", self.after),
            ("of which the control itself", self.control),
            ("of which without G64 (exact path, G61)", self.exact),
        )
        lines = [
            f"{self.program} executed by LinuxCNC, original and compensated: {times} of feed motion, sampled every millisecond",
            *self.warnings,
            "distance of the tool point from the programmed path      median      largest",
            *(
                f"  {name:<50}{one.median_um:10.3f} {one.largest_um:12.3f} µm   line {one.line}: {one.block}"
                for name, one in rows
            ),
            "the control itself: distance from the path of the compensated program's words (corners and blocks that G64 joins); "
            f"without G64: acceleration ({self.acceleration:g} mm/s²) and interpolation alone",
        ]
        return "\n".join([*lines, ""])

    def to_dict(self) -> dict[str, Any]:
        """Return a representation that can be written as JSON."""
        return {
            "schema": SCHEMA,
            "program": self.program,
            "control": "linuxcnc",
            "before": json_form(self.before),
            "after": json_form(self.after),
            "control_itself": json_form(self.control),
            "control_exact_path": json_form(self.exact),
            "samples": {"before": self.samples[0], "after": self.samples[1]},
            "acceleration_mm_s2": self.acceleration,
            "warnings": list(self.warnings),
        }


def verify(
    path: Path,
    compensator: Compensator,
    *,
    user: str = "",
    acceleration: float = DEFAULT_ACCELERATION,
    seconds: float = LONGEST_S,
) -> Verification:
    """Execute a program and its compensated form on LinuxCNC, run by ``user`` (if empty, the present one); mm/s² and °/s².

    `InputError` if LinuxCNC is missing or refuses the program, or the program is none of its language or not in axis words.
    """
    linuxcnc.check(user)
    program, dialect = read_program(path)
    if dialect.name != "iso":
        raise InputError("not a program of LinuxCNC", expected="G-code", file=path, value=dialect.name)
    result = compensator.compensate(program, dialect)
    if any(move.tcp for move in result.reading.moves):
        raise InputError("tool centre point control", expected="a program in axis words for this control", file=path)
    prepared = compensator.prepared
    nominal, real = _Tips(prepared, real=False), _Tips(prepared, real=True)
    course = _Course(nominal, *_way(program, dialect, prepared))
    own = _Course(real, *_way(dialect.read(result.text.encode("latin-1"), str(path)), dialect, prepared))
    texts = {"original": program.text, "compensated": result.text, "exact": on_exact_path(result.text)}
    recorded = _executed(texts, compensator, path, user=user, acceleration=acceleration, seconds=seconds)
    lines = {name: text.splitlines() for name, text in texts.items()}
    (original, compensated, exact) = (recorded[name] for name in texts)
    found = Verification(
        str(path),
        _remaining(course.off(real, original), original.lines, lines["original"]),
        _remaining(course.off(real, compensated), compensated.lines, lines["compensated"]),
        _remaining(own.off(real, compensated), compensated.lines, lines["compensated"]),
        _remaining(own.off(real, exact), exact.lines, lines["exact"]),
        (len(original.lines), len(compensated.lines)),
        acceleration,
        tuple(warning_texts(prepared.calibration.warnings)),
    )
    if found.exact.largest_um > ELSEWHERE_UM:
        raise InputError(
            "LinuxCNC moves to other positions than those that the program means by these tables of work offsets and tools",
            expected="the control's own tables, and G43 where a tool's length counts",
            file=path,
            line=found.before.line,
            value=f"{found.before.block}: {found.before.largest_um / 1e3:.3f} mm away",
        )
    return found


def on_exact_path(text: str) -> str:
    """Return a program with G61 instead of every G64; comments and line numbers stay."""
    lines = []
    for line in text.splitlines(keepends=True):
        parts = _COMMENT.split(line)
        if any(_PATH_MODE.search(part) for part in parts[::2]):
            parts[::2] = [_PATH_TOLERANCE.sub("", _PATH_MODE.sub("G61", part)) for part in parts[::2]]
        lines.append("".join(parts))
    return "".join(lines)


class _Samples(NamedTuple):
    """Feed motions: positions of the motors (n, axes), tool lengths (n,) in mm, and lines (n,) of the program."""

    positions: np.ndarray
    lengths: np.ndarray
    lines: np.ndarray


@final
class _Tips:
    """Tool points of a machine with its errors, or without, for tools of several lengths."""

    def __init__(self, prepared: PreparedMachine, *, real: bool) -> None:
        self.machine, self._prepared, self._real = prepared.machine, prepared, real
        self._of: dict[float, Kinematics] = {}

    def at(self, positions: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """Return (n, 3) tool points in the work frame, mm, at positions (n, axes) with tools of (n,) lengths in mm."""
        points, sides = np.empty((len(positions), 3)), _sides(positions)
        for length in np.unique(lengths):
            rows = lengths == length
            points[rows] = 1e3 * self._with(float(length)).reached(positions[rows] * self.machine.scale, sides[rows])[1]
        return points

    def _with(self, length: float) -> Kinematics:
        prepared = self._prepared
        if length not in self._of:
            errors = prepared.calibration if self._real else Calibration.zero(prepared.machine)
            conditions = prepared.options.conditions if self._real else None
            self._of[length] = Kinematics(prepared.machine, errors, tool_length_mm=length, conditions=conditions)
        return self._of[length]


def _way(program: Program, dialect: Dialect, prepared: PreparedMachine) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (n, axes) along a program, between which the axes move on straight lines, and tool lengths (n,)."""
    space = prepared.space
    reading = dialect.moves(program, space.axes, tcp=False)
    _, _, parts = follow_sections(program, reading, space)
    positions, lengths = [], []
    for part in parts:
        positions.append(execute(program, part.path, part.space, prepared.real, context=part.context).positions)
        lengths.append(np.full(len(positions[-1]), part.space.nominal.tool_length_mm))
    return np.vstack(positions), np.concatenate(lengths)


@final
class _Course:
    """A path in the workpiece, as a polyline through (n, axes) positions, reached with tools of (n,) lengths in mm."""

    def __init__(self, tips: _Tips, positions: np.ndarray, lengths: np.ndarray) -> None:
        # Where the tool changes, the path goes on at the same position with the other tool.
        changes = np.flatnonzero(np.diff(lengths)) + 1
        positions, lengths = (
            np.insert(positions, changes, positions[changes - 1], axis=0),
            np.insert(lengths, changes, lengths[changes]),
        )
        limits = np.where([axis.linear for axis in tips.machine.axes], STEP_MM, STEP_DEG)
        counts = np.maximum(1, np.ceil((np.abs(np.diff(positions, axis=0)) / limits).max(axis=1))).astype(int)
        starts = np.repeat(np.arange(len(counts)), counts)
        share = (np.arange(len(starts)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[starts]
        rows = positions[starts] + share[:, None] * (positions[starts + 1] - positions[starts])
        used = np.append(lengths[starts], lengths[-1])
        self._points = tips.at(np.vstack([rows, positions[-1:]]), used)
        self._joined = np.diff(used) == 0.0
        self._tree = cKDTree(self._points)
        parts = np.linalg.norm(np.diff(self._points, axis=0), axis=1)[self._joined]
        self._half = 0.5 * float(parts.max(initial=0.0))

    def off(self, tips: _Tips, samples: _Samples) -> np.ndarray:
        """Return (n,) distances, µm, of the tool point at positions of the motors from the path."""
        points = tips.at(samples.positions, samples.lengths)
        found, rows, count = np.full(len(points), np.inf), np.arange(len(points)), 1
        while len(rows):
            count = min(4 * count, len(self._points))
            away, nearest = self._tree.query(points[rows], k=count)
            for vertex in nearest.T:
                for begin in (np.maximum(vertex - 1, 0), np.minimum(vertex, len(self._points) - 2)):
                    found[rows] = np.minimum(found[rows], self._from(points[rows], begin))
            if count == len(self._points):
                break
            # The ends of all other parts are farther away. Where the path crosses itself, the nearest end may be of another part.
            rows = rows[found[rows] > np.sqrt(np.maximum(away[:, -1] ** 2 - self._half**2, 0.0))]
        return 1e3 * found

    def _from(self, points: np.ndarray, begin: np.ndarray) -> np.ndarray:
        """Return (n,) distances, mm, of points from parts of the path, given by their first vertices."""
        start = self._points[begin]
        along = (self._points[begin + 1] - start) * self._joined[begin][:, None]
        length = np.maximum((along**2).sum(axis=1), 1e-30)
        share = np.clip(((points - start) * along).sum(axis=1) / length, 0.0, 1.0)
        return np.asarray(np.linalg.norm(points - start - share[:, None] * along, axis=1))


def _sides(positions: np.ndarray) -> np.ndarray:
    """Return (n, axes) the direction in which each axis moved last, 0 before it has moved."""
    steps = np.vstack([np.zeros(positions.shape[1]), np.diff(positions, axis=0)])
    moved = np.where(np.abs(steps) > 1e-9, np.arange(len(steps))[:, None], 0)
    last = np.maximum.accumulate(moved, axis=0)
    return np.sign(np.take_along_axis(steps, last, axis=0))


def _remaining(off: np.ndarray, lines: np.ndarray, texts: Sequence[str]) -> PathDistance:
    worst = int(np.argmax(off))
    line = int(lines[worst])
    block = texts[line - 1].strip() if 0 < line <= len(texts) else ""
    return PathDistance(float(np.median(off)), float(off[worst]), line, block)


def _executed(
    texts: dict[str, str], compensator: Compensator, path: Path, *, user: str, acceleration: float, seconds: float
) -> dict[str, _Samples]:
    """Return the feed motions of each program, each executed by a control that has just been started."""
    prepared = compensator.prepared
    machine = prepared.machine
    home = {axis.name: 0.0 if axis.lower is None else sum(axis.domain) / 2.0 for axis in machine.axes}
    motors = [f"motor-{i}" for i in range(len(machine.names))]
    table, lengths = _tools(prepared)
    configuration = linuxcnc.Configuration(
        machine,
        home,
        pins=[
            *motors,
            "motion.tooloffset.z",
            "#iocontrol.0.tool-number",
            "#motion.program-line",
            "#motion.motion-type",
        ],
        tools=table,
        parameters=_parameters(prepared.space.setup, machine),
        acceleration=acceleration,
    )
    found = {}
    for name, text in texts.items():
        # The mode that a program without G61 and G64 runs in.
        actions: list[list[Any]] = [["home"], ["mdi", "G61" if name == "exact" else "G64"], ["record", "samples.txt"]]
        actions += [["program", "program.ngc", seconds], ["stop"]]
        with tempfile.TemporaryDirectory(prefix="twin-verify-") as scratch:
            folder = Path(scratch)
            (folder / "program.ngc").write_bytes(text.encode("latin-1"))
            ran = linuxcnc.run(folder, configuration, actions, user=user, seconds=seconds)
            if ran.failed:
                said = " ".join(ran.said) or ran.failed
                raise InputError(
                    "LinuxCNC refuses the program", expected="a program that it executes", file=path, value=said
                )
            rows = ran.samples("samples.txt")
        rows = rows[np.isin(rows[:, -1], _FEEDS)]
        if not len(rows):
            raise InputError("the program has no feed motion", expected="blocks with G1, G2 or G3", file=path)
        # The motors count from the position at which the axes stand when they are homed.
        positions = rows[:, : len(motors)] + np.array([home[axis] for axis in machine.names])
        offset, tool = rows[:, -4], rows[:, -3].astype(int)
        of_tool = np.array([lengths.get(number, prepared.space.nominal.tool_length_mm) for number in tool])
        found[name] = _Samples(positions, np.where(offset != 0.0, offset, of_tool), rows[:, -2].astype(int))
    return found


def _tools(prepared: PreparedMachine) -> tuple[str, dict[int, float]]:
    """Return the tool table of the control, and the lengths of the tools that it has."""
    setup = prepared.space.setup
    if setup.tools is not None:
        known = {int(name): length for name, length in setup.tools.lengths_mm.items() if name.isdecimal()}
        return "".join(f"T{number} P{number} Z{length:.6f}\n" for number, length in known.items()), known
    # Without a table of tools, words count the length only if there is a table of offsets.
    length = 0.0 if setup.offsets is None else prepared.space.nominal.tool_length_mm
    return "".join(f"T{number} P{number} Z{length:.6f}\n" for number in range(1, 100)), {}


def _parameters(setup: Setup, machine: Machine) -> str:
    """Return the parameter file of the control: its work offsets, the one in force, and the positions of reference returns."""
    table = setup.offsets
    rows = {"G54": setup.work_offset} if table is None else table.rows
    return parameter_file(rows, "" if table is None else table.assumed, machine.references)
