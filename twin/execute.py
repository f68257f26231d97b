"""A program executed on the machine with errors: where the tool was meant to go, and where it goes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.approach import LostMotion
from twin.kinematics import Kinematics
from twin.nc.blocks import Kind, Program
from twin.toolpath import Path, WordSpace, along, check_domains, chords, outside_range

SPACING: Final = (5.0, 2.0)
"""mm of linear and degrees of rotary motion between two points, at most."""
CHORD_MM: Final = 0.01
"""How closely arcs are followed."""


@final
@dataclass(frozen=True)
class Execution:
    """A program run once.

    Attributes:
        positions: (n, axes) commands, mm and degrees, command order.
        meant_mm: (n, 3) intended tool points in the work frame.
        sides: (n, axes) the side every axis comes from, as of `twin.approach`.
        reached_mm: (n, 3) tool points the machine reaches.
        tilt_urad: (n, 2) how the tool axis leans there against where it was meant to point (`Poses.tilt_urad`).
        cutting: (n,) False on rapids.
        ends: (n,) whether the point is the end of a block.
        lines: (n,) program line of each point.
        left_out: points outside an axis's range, which nothing is known of.
    """

    positions: np.ndarray
    meant_mm: np.ndarray
    sides: np.ndarray
    reached_mm: np.ndarray
    tilt_urad: np.ndarray
    cutting: np.ndarray
    ends: np.ndarray
    lines: np.ndarray
    left_out: int


def execute(program: Program, path: Path, space: WordSpace, real: Kinematics) -> Execution:
    """Run a program as its control would: straight in words between blocks, rapids drawn straight too.

    Args:
        program: the program.
        path: its motions (`twin.toolpath.follow`).
        space: words to commands on the machine as drawn.
        real: the machine with errors, same tool length, and the temperatures and time its effects need.

    Raises:
        InputError: a position in the axis's range that its error motions do not cover.
    """
    words, tcp, cutting, ends, lines, of = [], [], [], [], [], []
    for i, motion in enumerate(path.motions):
        fractions = np.array([1.0])
        if np.isfinite(motion.start).all():
            size = np.abs(motion.end - motion.start)
            steps = max(size[:3].max() / SPACING[0], size[3:].max(initial=0.0) / SPACING[1], chords(motion, CHORD_MM))
            fractions = np.arange(1, int(np.ceil(max(steps, 1.0))) + 1) / np.ceil(max(steps, 1.0))
        words.append(along(motion, fractions) if np.isfinite(motion.start).all() else motion.end[None, :])
        of += [i] * len(fractions)
        tcp += [motion.move.tcp] * len(fractions)
        cutting += [motion.move.kind is not Kind.RAPID] * len(fractions)
        ends += [False] * (len(fractions) - 1) + [True]
        lines += [program.lines[motion.move.line].number] * len(fractions)
    positions = space.commands(np.concatenate(words), np.array(tcp))
    check_domains(real, program.source, np.array(lines)[ends], positions[ends])
    sides = LostMotion(real.calibration).sides(path, np.array(of), positions)
    keep = ~outside_range(space.machine, positions) & ~real.outside_domain(positions).any(axis=1)
    positions, sides = positions[keep], sides[keep]
    meant, reached = space.nominal.forward(positions), real.forward(positions, sides)
    return Execution(
        positions=positions,
        meant_mm=meant.point_mm,
        sides=sides,
        reached_mm=reached.point_mm,
        tilt_urad=reached.tilt_urad(meant),
        cutting=np.array(cutting)[keep],
        ends=np.array(ends)[keep],
        lines=np.array(lines)[keep],
        left_out=int(np.count_nonzero(~keep)),
    )
