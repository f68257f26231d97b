"""Words and commands: conversion between a program's numbers and axis positions of one machine.

*Words* are a program's numbers made absolute, in the order of `AxisWords.names`: x, y, z, then rotary axes. *Commands* are axis
coordinates in command order. In mode ``axis`` words are commands less the work offset. In mode ``tcp`` the first three words are the
tool tip in the work frame, and the control finds the commands by the nominal inverse. Between blocks the control moves on straight
lines in words.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, final

import casadi as ca
import numpy as np
import pinocchio as pin

from twin._common.arrays import all_within, rows_all_true
from twin._common.errors import InputError
from twin._common.resources import builds_expressions
from twin._common.units import MM
from twin.compute.along import BatchFunction
from twin.controls.offsets import OffsetTable, ToolTable
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.effects.empirical import check_ranges
from twin.nc.blocks import AxisWords, Move
from twin.tool.forward import Kinematics
from twin.tool.inverse import Branches, Inverse

PROBE_MM = 100.0
"""By which an unknown word is changed to see which words of the other mode depend on it."""
SAME_MM = 1e-6


@final
@dataclass(frozen=True)
class Setup:
    r"""Set-up of the workpiece.

    Attributes:
        work_offset: added to axis words, by axis name, mm and degrees.
        work_origin_mm: the program's zero in the work frame, for tool-tip coordinates.
        start_deg: positions of rotary axes before the program names them, by axis name; 0 if missing.
        offsets: the machine's work offsets, from which the program selects; they replace the two above.
        tools: lengths of the tools that the program calls.
        one_tool: whether a program without that table must keep to one tool. Its length is of no effect on a machine without errors.
        harmless, auxiliary_axes: those of the job, in addition to those of the machine file (`twin.Machine`).

    Examples:
        >>> from pathlib import Path
        >>> machine = twin.Machine.load("dmu50")
        >>> setup = twin.Setup(work_offset={"X": 250.0, "Y": 225.0, "Z": -300.0})
        >>> _ = Path("bore.nc").write_text("G0 X0 Y0 Z50\nG1 Z0 F200\n")
        >>> result = twin.compensate("bore.nc", machine, options=twin.Options(setup=setup, tool_length_mm=120))
        >>> result.nominal[-1]  # positions of the axes at the end
        array([ 250.,  225., -300.,    0.,    0.])
    """

    work_offset: Mapping[str, float] = field(default_factory=dict)
    work_origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    start_deg: Mapping[str, float] = field(default_factory=dict)
    offsets: OffsetTable | None = None
    tools: ToolTable | None = None
    one_tool: bool = True
    harmless: tuple[str, ...] = ()
    auxiliary_axes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raise `InputError` if offsets are given twice."""
        if self.offsets is not None and (any(self.work_offset.values()) or any(self.work_origin_mm)):
            raise InputError(
                "work offsets given twice",
                expected="the table of work offsets, or one work offset and origin",
                file=self.offsets.path,
                setting="work offset",
            )


def axis_words(machine: Machine) -> AxisWords:
    """Return the words of a machine's programs, linear axes in the order x, y, z of the work frame, or raise `InputError`."""
    machine.check_programs()
    data = machine.model.createData()
    pin.framesForwardKinematics(machine.model, data, pin.neutral(machine.model))
    to_work = data.oMf[machine.work_frame].rotation.T
    order: dict[int, str] = {}
    for i in machine.linear:
        axis = machine.axes[i]
        frame = next(frame for frame in machine.frames if frame.axis == axis.name and frame.role == "motion")
        motion = to_work @ data.oMi[frame.joint].rotation @ np.array(axis.direction)
        motion = -motion if axis.side == "work" else motion
        along = int(np.argmax(motion))
        if motion[along] < 1.0 - 1e-9:
            raise InputError(
                f"axis {axis.name} does not move the tool along x, y or z",
                expected="linear axes along the work frame",
                file=machine.path,
            )
        order[along] = axis.name
    if sorted(order) != [0, 1, 2]:
        raise InputError(
            "the machine does not have three perpendicular linear axes",
            expected="a five-axis machine, to run programs",
            file=machine.path,
        )
    return AxisWords(
        linear=tuple(order[i] for i in range(3)),
        rotary=tuple(machine.axes[i].name for i in machine.rotary),
        increment={axis.name: axis.increment for axis in machine.axes},
        tcp_on=machine.tcp_on,
        tcp_off=machine.tcp_off,
        harmless=machine.harmless,
        references=machine.references,
    )


def _auxiliary(machine: Machine, setup: Setup) -> tuple[str, ...]:
    """Return the auxiliary axes of a machine and a job; raise `InputError` for one that is no such name, or an axis of the model."""
    names = tuple(dict.fromkeys(name.upper() for name in (*machine.auxiliary_axes, *setup.auxiliary_axes)))
    for name in names:
        if name not in set("XYZABCUVW") - {*machine.names}:
            expected = f"a letter of an axis that the model does not have (it has {', '.join(machine.names)})"
            raise InputError(
                "auxiliary axis", expected=expected, file=machine.path, value=name, setting="auxiliary axes"
            )
    return names


def turns_tool(moves: Iterable[Move], axes: AxisWords) -> bool:
    """Return whether any move names a rotary axis or gives a tool vector."""
    rotary = set(axes.rotary)
    return any(move.vector is not None or move.named & rotary for move in moves)


@final
@dataclass(frozen=True, eq=False)
class Tilt:
    """A tilted plane on one machine."""

    rotation: np.ndarray  # (3, 3) its axes in the work frame, as columns
    origin_mm: np.ndarray  # (3,) its zero in the work frame
    rotary_deg: np.ndarray  # (rotary axes,) commands at which the tool is perpendicular to it
    stays: bool  # whether the linear axes stay while the rotary axes turn there


@final
class WordSpace:
    """Conversion between words and commands, for one machine, tool length and set-up.

    ``tilt``: the tilted plane of the words; None if they are parallel to the linear axes; ``turn``: (3, 3) axes of the words x, y, z
    along the linear axes, as columns, outside a tilted plane; None if they are parallel. ``order``: (axes,) column of the commands of
    each word. ``like``: words of the same machine with the same tool length, whose models are shared.
    """

    def __init__(
        self,
        machine: Machine,
        setup: Setup,
        tool_length_mm: float | None,
        tilt: Tilt | None = None,
        turn: np.ndarray | None = None,
        *,
        like: WordSpace | None = None,
    ) -> None:
        self.machine, self.setup, self.tool_length_mm = machine, setup, tool_length_mm
        self._like = like
        self.axes: AxisWords = replace(
            axis_words(machine) if like is None else like.axes,
            offsets_known=setup.offsets is not None,
            tools_known=setup.tools is not None,
            one_tool=setup.one_tool,
            harmless=(*machine.harmless, *(word.upper() for word in setup.harmless)),
            auxiliary_axes=_auxiliary(machine, setup),
        )
        if like is None:
            self.nominal = Kinematics(machine, Calibration.zero(machine), tool_length_mm=tool_length_mm)
            self.inverse = Inverse(self.nominal)
        else:
            self.nominal, self.inverse = like.nominal, like.inverse
        self.order = np.array([machine.names.index(name) for name in self.axes.names])
        self.offset = np.array([setup.work_offset.get(name, 0.0) for name in self.axes.names])
        self.origin = np.array(setup.work_origin_mm)
        self.start = np.array([setup.start_deg.get(name, 0.0) for name in self.axes.rotary])
        self.tilt, self.turn = tilt, turn
        if tilt is not None:
            self.origin, self.start = tilt.origin_mm, tilt.rotary_deg - self.offset[3:]

    @cached_property
    def branches(self) -> Branches:
        """Rotary solutions for tool vectors."""
        return Branches(self.nominal) if self._like is None else self._like.branches

    def commands(self, words: np.ndarray, tcp: np.ndarray) -> np.ndarray:
        """Return the (n, axes) commands that the control derives from (n, axes) words; ``tcp``: (n,) mode of each."""
        tips = self.tilt is not None or bool(np.any(tcp))
        if self._same and not tips:
            return words
        shifted = self.positions(words)
        if tips:
            rows = self._tip_rows(words, tcp)
            points = words[rows, :3] if self._tip_turn is None else words[rows, :3] @ self._tip_turn.T
            rotary, scale = shifted[rows, 3:], self.machine.scale[self.order[3:]]
            (linear,) = self._linear_axes_of_rows(points + self.origin, rotary)
            # To radians and back, as the solver of the corrected commands does: no difference in rounding.
            shifted[rows] = np.hstack([linear, rotary * scale / scale])
        return self.displacements(shifted)

    def commands_at(self, words: Any) -> Any:
        """Return `commands` as an expression of (axes,) words of the tool tip outside a tilted plane."""
        rotary = words[3:] + ca.DM(self.offset[3:])
        tip = words[:3] if self._tip_turn is None else ca.DM(self._tip_turn) @ words[:3]
        linear = self._linear_axes(tip + ca.DM(self.origin), rotary)
        return ca.vertcat(linear, rotary)[np.argsort(self.order).tolist()]

    @cached_property
    @builds_expressions
    def _linear_axes_of_rows(self) -> BatchFunction:
        return BatchFunction(self._linear_axes) if self._like is None else self._like._linear_axes_of_rows

    @cached_property
    def _linear_axes(self) -> ca.Function:
        """Commands of the linear axes, mm, by tool tip in the work frame (mm) and rotary axes (degrees), all in word order.

        The tip is linear in the commands of the linear axes: three equations with three unknowns.
        """
        if self._like is not None:
            return self._like._linear_axes
        scale = self.machine.scale[self.order]
        linear, rotary = ca.SX.sym("linear", 3), ca.SX.sym("rotary", len(self.order) - 3)
        words = ca.vertcat(linear, rotary) * ca.DM(scale)
        tip, _ = self.nominal.tip_and_axis_at(words[np.argsort(self.order).tolist()])
        x, y, z = ca.horzsplit(ca.jacobian(tip, linear))
        wanted = ca.SX.sym("tip", 3)
        left = wanted * MM - ca.substitute(tip, linear, ca.DM.zeros(3))
        others = [ca.cross(a, b) for a, b in ((y, z), (z, x), (x, y))]
        solved = ca.vertcat(*(ca.dot(left, other) for other in others)) / ca.dot(x, others[0])
        return ca.Function("linear_axes", [wanted, rotary], [ca.cse(ca.densify(solved))])

    @property
    def _tip_turn(self) -> np.ndarray | None:
        """(3, 3) axes, as columns, of the words that are places of the tool tip, in the work frame; None if they are parallel."""
        return self.turn if self.tilt is None else self.tilt.rotation

    def tool_axes(self, rotary_deg: np.ndarray) -> np.ndarray:
        """Return (3, 3) axes of the tool in the work frame, as columns, at commands of the rotary axes."""
        commands = np.zeros((1, len(self.order)))
        commands[:, self.order[3:]] = rotary_deg
        return np.asarray(self.nominal.forward(commands).rotation[0])

    @property
    def parallel(self) -> bool:
        """Whether each linear word moves one linear axis outside tool centre point mode."""
        return self.tilt is None and self.turn is None

    def positions(self, words: np.ndarray) -> np.ndarray:
        """Return (n, axes) positions of the axes, in word order, at axis words outside a tilted plane; NaN where one is unknown."""
        return (words if self.turn is None else _turned(words, self.turn)) + self.offset

    def of_positions(self, positions: np.ndarray) -> np.ndarray:
        """Return the (n, axes) axis words of positions in word order; NaN where one is unknown."""
        words = positions - self.offset
        return words if self.turn is None else _turned(words, self.turn.T)

    def displacements(self, words: np.ndarray) -> np.ndarray:
        """Return (n, axes) displacements of axis words in command order."""
        return words if self._ordered else words[:, np.argsort(self.order)]

    @cached_property
    def _ordered(self) -> bool:
        return bool(np.all(self.order == np.arange(len(self.order))))

    @cached_property
    def _same(self) -> bool:
        """Whether axis words are commands: the same order, and no offset."""
        return self._ordered and self.turn is None and not np.any(self.offset)

    def switched(self, words: np.ndarray, *, tcp: bool) -> np.ndarray:
        """Return (n, axes) words converted from the other mode to the mode ``tcp``."""
        into = np.full(len(words), tcp)
        return self.words(self.commands(words, ~into), into)

    def switched_if_known(self, words: np.ndarray, *, tcp: bool) -> np.ndarray:
        """Return (axes,) words converted likewise; NaN where they depend on a word that is unknown (NaN)."""
        unknown = np.flatnonzero(np.isnan(words))
        if (unknown >= 3).any():
            return np.where(np.arange(len(words)) < 3, np.nan, words)
        base = np.nan_to_num(words)
        trials = self.switched(np.array([base, *(base + np.eye(len(words))[i] * PROBE_MM for i in unknown)]), tcp=tcp)
        return np.where((np.abs(trials - trials[0]) < SAME_MM).all(axis=0), trials[0], np.nan)

    def words(self, commands: np.ndarray, tcp: np.ndarray) -> np.ndarray:
        """Return the (n, axes) words from which the control derives (n, axes) commands; ``tcp``: (n,) mode of each."""
        tips = self.tilt is not None or bool(np.any(tcp))
        if self._same and not tips:
            return commands
        words = self.of_positions(commands[:, self.order])
        if tips:
            rows = self._tip_rows(commands, tcp)
            points = self.nominal.forward(commands[rows]).point_mm - self.origin
            words[rows, :3] = points if self._tip_turn is None else points @ self._tip_turn
        return words

    def _tip_rows(self, known: np.ndarray, tcp: np.ndarray) -> np.ndarray | slice:
        """Return the rows whose words are places of the tool tip or on a tilted plane, and that are ``known`` (n, axes)."""
        chosen = (tcp | (self.tilt is not None)) & rows_all_true(np.isfinite(known))
        return slice(None) if chosen.all() else np.flatnonzero(chosen)


def _turned(words: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Return words with the first three turned; one that is unknown (NaN) leaves only those unknown that depend on it."""
    turned = words.copy()
    parts = np.where(turn == 0.0, 0.0, words[..., None, :3] * turn)
    turned[..., :3] = parts.sum(axis=-1)
    return turned


def outside_range(machine: Machine, commands: np.ndarray) -> np.ndarray:
    """Return (n,) whether commands (mm, degrees) leave an axis's range; True for NaN."""
    lower, upper = (machine.limits / machine.scale[:, None] + np.array([-1e-9, 1e-9])).T
    if all_within(commands, lower, upper):  # the usual case
        return np.zeros(len(commands), dtype=bool)
    return ~rows_all_true((commands >= lower) & (commands <= upper))


def check_domains(real: Kinematics, source: str, lines: np.ndarray, commands: np.ndarray) -> None:
    """Raise `InputError` for a position within an axis's range that its curves or effects do not cover."""
    outside = real.calibration.outside_domains(commands)
    if not (outside.any() or real.calibration.bounded):
        return
    inside = ~outside_range(real.machine, commands)
    outside &= inside[:, None]
    if np.any(outside):
        row, column = np.argwhere(outside)[0]
        lo, hi = real.calibration.domains()[column]
        axis = real.machine.axes[column]
        raise InputError(
            f"{axis.name} outside the domain of its error motions in {real.calibration.path or 'the calibration'}",
            expected=f"{lo:g} to {hi:g} {axis.unit}",
            file=source,
            line=int(lines[row]),
            value=f"{axis.name} {commands[row, column]:.6g}",
        )
    check_ranges(real.calibration.bounded, real.calibration.state(commands[inside]), lines[inside], source)
