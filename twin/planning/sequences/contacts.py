"""Contacts of a touch probe on a sphere: directions that keep the stylus away from the stem of the sphere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.machine.machine import Machine
from twin.planning.sequences.positions import carried_points_mm
from twin.planning.sequences.specification import SequenceTask

SIDEWAYS: Final = 0.1
"""Share of the stem's direction across the tool axis above which contacts are placed at 45° to it."""
ASIDE: Final = 0.17
"""Largest share of the stem's direction towards the spindle: the stem then stays below the equator."""


@final
@dataclass(frozen=True)
class ContactPose:
    """A pose at a sphere: position with the tip at its centre, and the directions of the contacts.

    Attributes:
        centre: (axes,) position with the tip at the nominal centre.
        to_axes: (3, 3) motion of the linear axes for a motion of the tip in the base frame.
        up: (3,) from the tip to the spindle, base frame.
        stem: (3,) from the sphere along its stem, base frame.
        sides: (4, 3) directions of the contacts at the equator, outwards, base frame.
    """

    centre: np.ndarray
    to_axes: np.ndarray
    up: np.ndarray
    stem: np.ndarray
    sides: np.ndarray

    def at(self, machine: Machine, away_mm: np.ndarray) -> np.ndarray:
        """Return the position (axes,) with the tip away from the centre by a vector of the base frame, mm."""
        found = np.array(self.centre)
        found[list(machine.linear)] += self.to_axes @ away_mm
        return found

    @property
    def stem_aside(self) -> bool:
        """Whether the stem does not point towards the spindle."""
        return bool(self.stem @ self.up < ASIDE)


def contact_poses(task: SequenceTask, positions: np.ndarray, places_mm: np.ndarray) -> list[ContactPose]:
    """Return the poses at spheres with their directions, from the nominal kinematics.

    Args:
        task: machine and tip.
        positions: (n, axes) with the tip at the spheres' centres, mm and degrees.
        places_mm: (n, 3) the spheres in the work frame.
    """
    machine, tip = task.machine, np.tile(np.array(task.tip_mm), (len(positions), 1))
    along = np.array([0.0, 0.0, 1.0])

    def gap(q: np.ndarray) -> np.ndarray:
        return carried_points_mm(machine, q, "tool", tip) - carried_points_mm(machine, q, "work", places_mm)

    here = carried_points_mm(machine, positions, "tool", tip)
    ball = carried_points_mm(machine, positions, "work", places_mm)
    up = carried_points_mm(machine, positions, "tool", tip + along) - here
    stem = carried_points_mm(machine, positions, "work", places_mm - along) - ball
    moved = [gap(positions + np.eye(len(machine.axes))[i]) - (here - ball) for i in machine.linear]
    to_axes = np.linalg.inv(np.stack(moved, axis=2))
    return [ContactPose(*row, _sides(row[2], row[3])) for row in zip(positions, to_axes, up, stem, strict=True)]


def _sides(up: np.ndarray, stem: np.ndarray) -> np.ndarray:
    """Return (4, 3) directions at the equator: the stem's direction across the tool axis is halfway between two of them.

    Args:
        up: (3,) from the tip to the spindle.
        stem: (3,) from the sphere along its stem.
    """
    across = stem - (stem @ up) * up
    if np.linalg.norm(across) < SIDEWAYS:
        across = np.eye(3)[int(np.argmin(np.abs(up)))]
        first = across - (across @ up) * up
        first /= np.linalg.norm(first)
        second = np.cross(up, first)
    else:
        across /= np.linalg.norm(across)
        other = np.cross(up, across)
        first, second = (across + other) / np.sqrt(2.0), (other - across) / np.sqrt(2.0)
    # Neighbours in turn, so that the way over the sphere is short.
    return np.array([first, second, -first, -second])
