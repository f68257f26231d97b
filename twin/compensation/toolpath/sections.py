"""Sections of a program: consecutive motions in the same frame, with its own work offset and tool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from twin.compensation.toolpath.frames import FrameSpaces
from twin.compensation.toolpath.motions import MotionColumns, ToolPath
from twin.compensation.toolpath.words import WordSpace
from twin.nc.blocks import Interpretation, WordFrame
from twin.nc.columns import as_columns


@final
@dataclass(frozen=True)
class Section:
    """Lines of a program in the same frame.

    Attributes:
        line: 0-based index of the first line.
        frame: the frame.
        space: conversion of its words, with its work offset and tool.
        from_tables: whether a table of work offsets or tools is known.
        assumed_offset: name of the work offset in force before the program selects one; empty without a table of them.
    """

    line: int
    frame: WordFrame
    space: WordSpace
    from_tables: bool = False
    assumed_offset: str = ""


@final
@dataclass(frozen=True)
class SectionMotions:
    """The motions of a section.

    Attributes:
        space: conversion of the section's words.
        path: the motions, after ``context`` motions of the section before in the words of this one.
        begin, end: the range of its own motions among those of the program.
        context: 1, or 0 in the first section.
    """

    space: WordSpace
    path: ToolPath
    begin: int
    end: int
    context: int


def sections(base: WordSpace, source: str, reading: Interpretation) -> list[Section]:
    """Return the sections of a program; one if it has neither a table of work offsets nor one of tools.

    Args:
        base: conversion of words, with the tables of work offsets and tools.
        source: name of the program, for messages.
        reading: its moves.

    Raises:
        InputError: a work offset or a tool that is not in its table.
    """
    setup = base.setup
    if setup.offsets is None and setup.tools is None and not reading.frames:
        return [Section(0, WordFrame(), base)]
    frames = FrameSpaces(base)
    standing = base.start + base.offset[3:]
    assumed = "" if setup.offsets is None else setup.offsets.assumed
    moves = as_columns(base.axes.names, reading.moves)
    lines, positions = moves.line[~moves.passes], moves.position[~moves.passes]
    starts = [(0, WordFrame()), *reading.frames]
    found: list[Section] = []
    for place, (line, frame) in enumerate(starts):
        end = starts[place + 1][0] if place + 1 < len(starts) else np.inf
        own = lines[(lines >= line) & (lines < end)]
        if own.size:
            before = positions[: np.searchsorted(lines, line)]
            at = standing if frame.plane is None else _standing(before, standing, base)
            space = frames.of(frame, source, int(own[0]) + 1, at)
            standing = standing if space.tilt is None else space.tilt.rotary_deg
            if not found or found[-1].space is not space:
                found.append(Section(line if found else 0, frame, space, True, assumed))
    return found or [Section(0, WordFrame(), base)]


def _standing(positions: np.ndarray, first: np.ndarray, base: WordSpace) -> np.ndarray:
    """Return (rotary axes,) the commands of the rotary axes after moves; ``first``: those at the beginning of their section."""
    words = positions[-1, 3:] + base.offset[3:] if len(positions) else first
    return np.where(np.isnan(words), first, words)


def spaces(found: Sequence[Section]) -> tuple[WordSpace, list[tuple[int, WordSpace]]]:
    """Return the conversion of the first section, and those of the others with their first lines, as `follow` takes them."""
    return found[0].space, [(section.line, section.space) for section in found[1:]]


def motions_of(found: Sequence[Section], path: ToolPath) -> list[SectionMotions]:
    """Return the motions of every section that has any."""
    if len(found) == 1:
        return [SectionMotions(found[0].space, path, 0, len(path.columns), 0)]
    cuts = np.searchsorted(path.columns.line, [section.line for section in found[1:]]).tolist()
    parts: list[SectionMotions] = []
    before: WordSpace | None = None
    for section, begin, end in zip(found, [0, *cuts], [*cuts, len(path.columns)], strict=True):
        if begin == end:
            continue
        space = section.space
        context = 0 if before is None else 1
        part = path.part(begin - context, end)
        if before is not None:
            part = replace_first(part, before, space)
        parts.append(SectionMotions(space, part, begin, end, context))
        before = space
    return parts or [SectionMotions(found[0].space, path, 0, 0, 0)]


def replace_first(path: ToolPath, before: WordSpace, space: WordSpace) -> ToolPath:
    """Return a path whose first motion has no length: it stays on its end point, in words of another conversion.

    Args:
        path: the path.
        before: conversion of its first motion.
        space: conversion of the other motions.
    """
    columns = path.columns
    mode = columns.tcp[:1]
    end = space.words(before.commands(columns.end[:1], mode), mode)
    special = {i: move for i, move in columns.special.items() if i}
    changed = MotionColumns(
        columns.move,
        columns.line,
        columns.rapid,
        columns.tcp,
        np.concatenate([end, columns.start[1:]]),
        np.concatenate([end, columns.end[1:]]),
        columns.by_vector & (np.arange(len(columns)) > 0),
        special,
    )
    return replace(path, motions=changed, columns=changed)
