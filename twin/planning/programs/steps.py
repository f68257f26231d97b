"""Steps of a measuring program: retract, turn, approach, five contacts, each move checked for ranges and clearance."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from twin._common.errors import InputError
from twin.planning.measure import SequencePlan
from twin.planning.programs.specification import (
    APPROACH_FEED,
    PROBING_FEED,
    ProgramStep,
    ProgramSteps,
)
from twin.planning.sequences import ContactPose, SequenceTask, apart_clearance, clearance_of, contact_poses

RETRACT_MM: Final = 400.0
"""Longest retraction from the sphere along the tool axis before rotary axes turn."""
SEARCH_SHARE: Final = 0.5
"""Largest search behind the expected contact, as a share of the distance of the centres at contact."""


def program_steps(plan: SequencePlan) -> ProgramSteps:
    """Return the steps of the measuring program of a plan with a touch probe.

    Args:
        plan: the plan.

    Raises:
        InputError: the plan is not for a probe, or no pose has a path with clearance.
    """
    if plan.task.instrument.specification.reads != "null":
        raise InputError(
            "a measuring program is for a touch probe", expected="a plan for a probe", value=plan.task.instrument.name
        )
    builder = PoseBuilder(plan.task)
    places = np.array([plan.task.places_mm[str(name)] for name in plan.table.target])
    for number, pose in enumerate(contact_poses(plan.task, plan.table.positions, places), start=1):
        builder.visit(number, pose)
    if not builder.poses:
        raise InputError(
            "no pose has a path with clearance", expected="another place of the sphere, or a smaller clearance"
        )
    return ProgramSteps(
        plan.machine,
        tuple(builder.steps),
        builder.poses,
        tuple(builder.skipped),
        tuple(_header(plan, builder)),
        tuple(str(name) for name in plan.table.target),
        (plan.task.sizes.sphere_mm / 2.0, plan.task.sizes.ball_mm / 2.0),
    )


class PoseBuilder:
    """Builds the steps pose by pose.

    Args:
        task: machine, instrument and parts on the table.
    """

    def __init__(self, task: SequenceTask) -> None:
        self.task = task
        self.machine = task.machine
        self.size = task.sizes
        self.touching = clearance_of(task.machine, task)
        self.apart = apart_clearance(self.touching)
        self.steps: list[ProgramStep] = []
        self.skipped: list[int] = []
        self.poses = 0

    def visit(self, number: int, pose: ContactPose) -> None:
        """Add the steps of one pose; without a path with clearance it is skipped."""
        above = pose.at(self.machine, self.size.around_mm * pose.up)
        high = self._retracted(pose)
        # The rapid move ends at twice the distance, so that a sphere that is not quite at its place is met at the feed.
        share = min(1.0, self.size.around_mm / max(float(np.linalg.norm(high - above)), 1e-9))
        near = above + share * (high - above)
        way = self._way(high)
        contacts = self._contacts(number, pose)
        if way is None or contacts is None or not self._inside([high, above]) or not self._clear([high, above]):
            self.skipped.append(number)
            return
        self.poses += 1
        self.steps += [ProgramStep("rapid", q, number) for q in (*way, near)]
        self.steps += [ProgramStep("feed", above, number), *contacts]
        # After the contacts the tip is above the sphere again.
        self.steps += [ProgramStep("feed", above, number), ProgramStep("rapid", high, number)]

    def _retracted(self, pose: ContactPose) -> np.ndarray:
        """Return the position with the tip retracted along the tool axis, at most to the end of the ranges."""
        linear = list(self.machine.linear)
        above = pose.at(self.machine, self.size.around_mm * pose.up)
        step = pose.to_axes @ pose.up
        low, high = self.task.kit.ranges[linear].T
        room = [
            ((high[i] if step[i] > 0.0 else low[i]) - above[linear][i]) / step[i]
            for i in range(3)
            if abs(step[i]) > 1e-9
        ]
        length = float(np.clip(min(room, default=0.0), 0.0, RETRACT_MM))
        return pose.at(self.machine, (self.size.around_mm + np.floor(length * 1e3) / 1e3) * pose.up)

    def _way(self, high: np.ndarray) -> list[np.ndarray] | None:
        """Return the positions from the last one to a retracted one; None if none of the ways tried is clear.

        The rotary axes turn first or last, or in between with one linear axis at an end of its range.
        """
        rotary = list(self.machine.rotary)
        if not self.steps:
            return self._first(high)
        here = self.steps[-1].position

        def turned(at: np.ndarray) -> np.ndarray:
            found = np.array(at)
            found[rotary] = high[rotary]
            return found

        back = np.array(high)
        back[rotary] = here[rotary]
        ways = [[turned(here), high], [back, high]]
        for i in self.machine.linear:
            for end in self.task.kit.ranges[i]:
                aside = np.array(here)
                aside[i] = end
                ways.append([aside, turned(aside), high])
        return next((way for way in ways if self._inside(way) and self._clear([here, *way])), None)

    def _first(self, high: np.ndarray) -> list[np.ndarray]:
        """Return the first positions: the axis along the tool first, then the rotary axes, then the others; NaN does not move."""
        linear, rotary = list(self.machine.linear), list(self.machine.rotary)
        along = max(linear, key=lambda i: abs(float(self.machine.axes[i].machine_direction[2])))
        found, now = [], np.full(len(high), np.nan)
        for axes in ([along], rotary, linear):
            now = np.array(now)
            now[axes] = high[axes]
            found.append(now)
        return found

    def _contacts(self, number: int, pose: ContactPose) -> list[ProgramStep] | None:
        """Return the steps of the five contacts from above the sphere; None if one is out of range or without clearance."""
        around, touch = self.size.around_mm, self.size.contact_mm
        deep = touch - min(self.size.clearance_mm, SEARCH_SHARE * touch)
        above = pose.at(self.machine, around * pose.up)
        found: list[ProgramStep] = []
        before = above
        for contact, out in enumerate((pose.up, *pose.sides), start=1):
            start, end = pose.at(self.machine, around * out), pose.at(self.machine, deep * out)
            over = pose.at(self.machine, around * (out + pose.up))
            moves = [] if contact == 1 else [over, start]
            inside = self._inside([*moves, start, end])
            probing = [start, pose.at(self.machine, touch * out)]
            if not (inside and self._clear([before, *moves]) and self._clear(probing, contact=True)):
                return None
            along = (end - start)[list(self.machine.linear)]
            length = float(np.linalg.norm(along))
            x, y, z = (float(v) for v in along / length)
            found += [ProgramStep("feed", q, number) for q in moves]
            found.append(ProgramStep("probe", end, number, contact, (x, y, z), length))
            found.append(ProgramStep("feed", start, number))
            before = start
            if contact > 1:
                found.append(ProgramStep("feed", over, number))
                before = over
        if not self._clear([before, above]):
            return None
        return found

    def _inside(self, positions: list[np.ndarray]) -> bool:
        """Return whether all positions are within the ranges; unlimited axes always are."""
        low, high = self.task.kit.ranges.T
        limited = np.array([axis.lower is not None for axis in self.machine.axes])
        q = np.array(positions)[:, limited]
        return bool(np.all(q >= low[limited] - 1e-9) and np.all(q <= high[limited] + 1e-9))

    def _clear(self, positions: list[np.ndarray], *, contact: bool = False) -> bool:
        """Return whether the straight moves between positions have clearance; stylus and sphere may touch if ``contact``."""
        checked = self.touching if contact else self.apart
        return all(checked.is_move_clear(a, b) for a, b in pairwise(positions))


def _header(plan: SequencePlan, builder: PoseBuilder) -> list[str]:
    """Return the comments of the program."""
    size, task = plan.task.sizes, plan.task
    places = ", ".join(f"{name} at x {x:g} y {y:g} z {z:g}" for name, (x, y, z) in task.places_mm.items())
    found = [
        "Measuring program by twin. UNTESTED ON A REAL CONTROL: read it, run it dry, then with low override.",
        f"machine: {plan.machine.name}; sequence {plan.sequence.name}, {builder.poses} poses, 5 contacts each",
        f"tool length {-task.tip_mm[2]:g} mm from the spindle nose to the centre of the stylus ball of {size.ball_mm:g} mm; "
        f"calibration sphere of {size.sphere_mm:g} mm; clearance {size.clearance_mm:g} mm",
        f"in the work frame, mm: {places}. The sphere must be there to within {size.clearance_mm / 2.0:g} mm, "
        "its stem square to the table.",
        "All positions are axis positions of the nominal machine without offsets, tool length or tool centre point control.",
        "Rotary axes must move by the difference of the programmed angles, not by the shorter way.",
        "Checked: ranges of the axes, and the shapes of the URDF with an assumed probe, stylus, sphere and stem. NOT checked: holders, "
        "clamps, cables, workpiece, and the way to the first pose.",
        f"equipment: {task.kit.source}",
        f"Contacts of each pose in order: from the spindle, then four at the equator. Feed {PROBING_FEED:g} mm/min, near the sphere "
        f"{APPROACH_FEED:g}.",
    ]
    if builder.skipped:
        found.append(
            "NOT PROBED for lack of clearance: poses " + ", ".join(map(str, builder.skipped)) + " of the plan."
        )
    return found
