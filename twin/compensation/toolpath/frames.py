"""Coordinates of a program that selects work offsets and tools: the set-up and the tool length of every frame.

The position of an axis is its word plus the work offset. To the third linear axis the control adds the length of the tool while one
is in force. In tool centre point mode the work offset moves the program's zero on the workpiece instead: it is the place of the spindle
nose at the offset's linear values and rotary axes at zero.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from typing import final

import numpy as np

from twin.compensation.toolpath.words import WordSpace
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.nc.blocks import Frame


@final
class Frames:
    """Conversions of words in the frames of one machine.

    Args:
        base: conversion with the tables of work offsets and tools; its tool length applies where they do not say one.
    """

    def __init__(self, base: WordSpace) -> None:
        self._base = base
        self._made: dict[Hashable, WordSpace] = {}
        self._nose = Kinematics(base.machine, Calibration.zero(base.machine), tool_length_mm=0.0)

    def of(self, frame: Frame, source: str, line: int) -> WordSpace:
        """Return the conversion of words in a frame; the same object for equal work offsets and tool lengths.

        Args:
            frame: the frame.
            source: name of the program, for messages.
            line: line of its first move in this frame.

        Raises:
            InputError: an unknown work offset or tool; an offset of an axis that the machine does not have.
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
        if frame.length and length is not None:
            along = base.axes.linear[2]
            shift[along] = shift.get(along, 0.0) + length
        key = tuple(sorted(shift.items())), origin, length
        if key not in self._made:
            plain = replace(setup, work_offset=shift, work_origin_mm=origin, offsets=None, tools=None)
            self._made[key] = WordSpace(base.machine, plain, length)
        return self._made[key]

    def _origin(self, shift: dict[str, float]) -> tuple[float, float, float]:
        commands = np.array([[shift[axis.name] if axis.linear else 0.0 for axis in self._base.machine.axes]])
        x, y, z = self._nose.forward(commands).point_mm[0].tolist()
        return x, y, z
