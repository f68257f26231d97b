"""Coordinates of a program that selects work offsets and tools: the set-up and the tool length of every frame.

The position of an axis is its word plus the work offset. To the third linear axis the control adds the length of the tool while one
is in force; without a table of tools, but with one of work offsets, always. In tool centre point mode the work offset moves the
program's zero on the workpiece instead: it is the place of the spindle nose at the offset's linear values and rotary axes at zero. In a
tilted plane the words are places on the tilted workpiece, and the control keeps the rotary axes at the positions of the plane.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from typing import final

import numpy as np

from twin._common.errors import InputError
from twin.compensation.toolpath.words import Tilt, WordSpace
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.nc.blocks import WordFrame
from twin.nc.planes import Plane


@final
class FrameSpaces:
    """Conversions of words in the frames of one machine.

    Args:
        base: conversion with the tables of work offsets and tools; its tool length applies where they do not say one.
    """

    def __init__(self, base: WordSpace) -> None:
        self._base = base
        self._made: dict[Hashable, WordSpace] = {}
        self._nose = Kinematics(base.machine, Calibration.zero(base.machine), tool_length_mm=0.0)

    def of(self, frame: WordFrame, source: str, line: int, standing_deg: np.ndarray) -> WordSpace:
        """Return the conversion of words in a frame; the same object for equal work offsets and tool lengths.

        Args:
            frame: the frame.
            source: name of the program, for messages.
            line: line of its first move in this frame.
            standing_deg: (rotary axes,) commands of the rotary axes before it.

        Raises:
            InputError: an unknown work offset or tool; a tilted plane that the machine cannot reach.
        """
        base, setup, length = self._base, self._base.setup, self._base.tool_length_mm
        tools = setup.tools
        tool = frame.length or frame.tool
        if tools is not None and tool not in ("", "0"):
            length = tools.of(tool, source, line) + frame.delta_mm
        elif tools is not None and tool == "0":
            length = 0.0
        shift = dict(setup.work_offset)
        origin = setup.work_origin_mm
        if setup.offsets is not None:
            row = setup.offsets.of(frame.offset, source, line)
            shift = {name: row.get(name, 0.0) for name in base.axes.names}
            origin = self._origin(shift)
        if frame.length or (tools is None and setup.offsets is not None):
            along = base.axes.linear[2]
            added = base.nominal.tool_length_mm if length is None else length
            shift[along] = shift.get(along, 0.0) + added
        key: tuple[Hashable, ...] = tuple(sorted(shift.items())), origin, length
        if key not in self._made:
            plain = replace(setup, work_offset=shift, work_origin_mm=origin, offsets=None, tools=None)
            self._made[key] = WordSpace(base.machine, plain, length)
        space = self._made[key]
        if frame.plane is None:
            return space
        rotary = self._rotary(space, frame.plane, standing_deg, source, line)
        key = (*key, frame.plane, tuple(rotary.tolist()))
        if key not in self._made:
            self._made[key] = WordSpace(base.machine, space.setup, length, self._tilt(space, frame.plane, rotary))
        return self._made[key]

    def _tilt(self, space: WordSpace, plane: Plane, rotary_deg: np.ndarray) -> Tilt:
        """Return a plane whose zero is given in the words of ``space``, with the rotary axes at zero."""
        if self._base.setup.offsets is None:
            zero = np.zeros((1, len(space.order)))
            zero[:, space.order] = np.where(np.arange(len(space.order)) < 3, space.offset, 0.0)
            origin = space.nominal.forward(zero).point_mm[0]
        else:
            origin = space.origin
        return Tilt(np.array(plane.rotation), origin + np.array(plane.origin_mm), rotary_deg, plane.stays)

    def _rotary(self, space: WordSpace, plane: Plane, standing_deg: np.ndarray, source: str, line: int) -> np.ndarray:
        """Return the commands of the rotary axes for a plane, rounded to their least increments.

        Raises:
            InputError: the machine does not reach it.
        """
        normal = np.array(plane.rotation)[:, 2]
        solutions = space.branches.all(normal[None])[0]
        if plane.choice:
            wrong = plane.choice * solutions[:, space.branches.master] < -1e-9
            solutions[wrong & ~wrong.all()] = np.nan
        (found,) = space.branches.nearest(solutions[None], standing_deg[None])
        if np.isnan(found).any():
            raise InputError(
                f"{space.machine.name} cannot reach this tilted plane",
                expected="a plane within the ranges of its rotary axes",
                file=source,
                line=line,
                value=" ".join(f"{value:.4g}" for value in normal),
            )
        increment = np.array([space.axes.increment[name] for name in space.axes.rotary])
        return np.asarray(np.round(found / increment) * increment)

    def _origin(self, shift: dict[str, float]) -> tuple[float, float, float]:
        commands = np.array([[shift[axis.name] if axis.linear else 0.0 for axis in self._base.machine.axes]])
        x, y, z = self._nose.forward(commands).point_mm[0].tolist()
        return x, y, z
