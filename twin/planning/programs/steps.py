"""Steps of a measuring program: retract, turn, approach, five contacts, each move checked for ranges and clearance."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Final

import numpy as np

from twin._common.errors import InputError
from twin.planning.drift import ALONG, STOP_S, DriftPlan
from twin.planning.kit import CONTACT_S
from twin.planning.measure import SequencePlan
from twin.planning.programs.controls import APPROACH_FEED, PROBING_FEED, ProgramStep, ProgramSteps
from twin.planning.sequences.contacts import ContactPose, apart_clearance, clearance_of, contact_poses
from twin.planning.sequences.specification import CONTACTS, POINT_S, SequenceTask

RETRACT_MM: Final = 400.0
"""Longest retraction from the sphere along the tool axis before rotary axes turn."""
SEARCH_SHARE: Final = 0.5
"""Largest search behind the expected contact, as a share of the distance of the centres at contact."""


def program_steps(plan: SequencePlan) -> ProgramSteps:
    """Return the steps of the measuring program of a plan with a touch probe; `InputError` if no pose has a path with clearance."""
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
        plan.task.tip_mm,
    )


class PoseBuilder:
    """Builds the steps pose by pose."""

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
        """Return clear positions from the last one to a retracted one; None if there are none.

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
        first, now = [], np.full(len(high), np.nan)
        for axes in ([along], rotary, linear):
            now = np.array(now)
            now[axes] = high[axes]
            first.append(now)
        return first

    def _contacts(self, number: int, pose: ContactPose) -> list[ProgramStep] | None:
        """Return the steps of the five contacts from above the sphere; None if one is out of range or without clearance."""
        around, touch = self.size.around_mm, self.size.contact_mm
        deep = touch - min(self.size.clearance_mm, SEARCH_SHARE * touch)
        above = pose.at(self.machine, around * pose.up)
        contacts: list[ProgramStep] = []
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
            contacts += [ProgramStep("feed", q, number) for q in moves]
            contacts.append(ProgramStep("probe", end, number, contact, (x, y, z), length))
            contacts.append(ProgramStep("feed", start, number))
            before = start
            if contact > 1:
                contacts.append(ProgramStep("feed", over, number))
                before = over
        if not self._clear([before, above]):
            return None
        return contacts

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
    header = [
        "Measuring program by twin. NOT RUN ON A MACHINE: read it, run it dry, then with low override.",
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
        header.append(
            "NOT PROBED for lack of clearance: poses " + ", ".join(map(str, builder.skipped)) + " of the plan."
        )
    return header


# --- Steps of the program of a drift test: spindle speeds, motion of the axis to and fro, dwells, and readings at their times

PUT_IN: Final = "put the touch probe in"
PUT_BACK: Final = "put the test tool back, then start again"
LEAST_DWELL_S: Final = 0.1


def drift_steps(plan: DriftPlan) -> ProgramSteps:
    """Return the steps of the program of a drift test; `InputError` if there is no path with clearance inside the ranges."""
    builder = _DriftBuilder(plan)
    for number in range(1, len(plan.table) + 1):
        builder.read(number)
    builder.finish()
    base = plan.task.base
    return ProgramSteps(
        base.machine,
        tuple(builder.steps),
        len(plan.table),
        (),
        tuple(_drift_steps_header(plan, builder)),
        tuple(str(name) for name in (plan.table.target if builder.probing else plan.table.station)),
        base.tip_mm,
        builder.probing,
    )


class _DriftBuilder(PoseBuilder):
    """Builds the steps reading by reading, and keeps account of the time."""

    def __init__(self, plan: DriftPlan) -> None:
        super().__init__(plan.task.base)
        self.plan = plan
        self.probing = plan.task.instrument == "probe"
        self.speed = 0.0
        self.elapsed = 0.0
        self.counted = 0
        self.latest_s = 0.0
        self.at_sphere = False
        self.ends: tuple[np.ndarray, np.ndarray] | None = None
        names = plan.table.target if self.probing else plan.table.station
        places = np.array([plan.task.base.places_mm[str(name)] for name in names])
        self.contact_poses = contact_poses(plan.task.base, plan.table.positions, places)

    @property
    def here(self) -> np.ndarray:
        """The position at which the steps so far end."""
        return self.steps[-1].position

    def read(self, number: int) -> None:
        """Add the steps of a reading: the way to it, the dwell until its time, the reading, the motion of the axis after it."""
        k = number - 1
        pose, time = self.contact_poses[k], float(self.plan.schedule.time_s[k])
        speed = float(self.plan.schedule.speed_rpm[k])
        if self.probing:
            self._probed(number, pose, time, speed)
        else:
            self._read_in_place(number, pose, time, speed)
        if self.plan.schedule.exercised[k] and number < len(self.plan.table):
            self._exercised(number, float(self.plan.schedule.time_s[number]))

    def finish(self) -> None:
        """Stop the spindle and retract."""
        self._turned(len(self.plan.table), 0.0)
        self._leave(len(self.plan.table))

    def _probed(self, number: int, pose: ContactPose, time: float, speed: float) -> None:
        self._turned(number, speed)
        high = self._retracted(pose)
        if speed > 0.0:
            self._waited(number, time)
            self._turned(number, 0.0)
            self.steps.append(ProgramStep("stop", self.here, number, text=PUT_IN))
        elif self.steps:
            self._moved(number, self._way_to(number, high))
            self._waited(number, time)
        before = len(self.skipped)
        self.visit(number, pose)
        if len(self.skipped) > before:
            raise _no_path(number)
        self._count()
        speeds = self.plan.schedule.speed_rpm
        if number < len(speeds) and speeds[number] > 0.0:
            self.steps.append(ProgramStep("stop", self.here, number, text=PUT_BACK))

    def _read_in_place(self, number: int, pose: ContactPose, time: float, speed: float) -> None:
        """Go to the pose, unless the tool is there, and read it at its time."""
        if not (self.at_sphere and np.array_equal(self.here, pose.centre)):
            self._leave(number)
            high = self._retracted(pose)
            if not self._clear([high, pose.centre], contact=True):
                raise _no_path(number)
            self._moved(number, [*self._way_to(number, high), self._near(pose)])
            self.steps.append(ProgramStep("feed", np.array(pose.centre), number))
            self.at_sphere = True
        self._turned(number, speed)
        self._count()
        self._waited(number, time)
        text = f"reading {number} at {time:.0f} s"
        self.steps += [
            ProgramStep("read", self.here, number, text=text),
            ProgramStep("dwell", self.here, number, seconds=POINT_S),
        ]
        self._count()

    def _exercised(self, number: int, until: float) -> None:
        """Move the axis to and fro as often as the time until the next reading allows."""
        self._leave(number)
        task = self.plan.task
        first, last = self._ends(number)
        self._moved(number, self._way_to(number, first))
        self._count()
        stroke_s = 60.0 * float(np.abs(last - first)[task.axis]) / task.feed
        following = self.contact_poses[number]
        back_s = self._seconds([first, self._retracted(following)]) + self._approach_s(following)
        count = int(max(until - self.elapsed - back_s, 0.0) // (2.0 * stroke_s))
        for _ in range(count):
            self.steps += [ProgramStep("feed", q, number, feed=task.feed) for q in (last, first)]
        self._count()

    def _ends(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the first ends of the motion to and fro that have clearance. Raises `InputError`: none of those tried has."""
        if self.ends is None:
            tried = self._linear_ends() if self.plan.task.moved.linear else self._rotary_ends()
            self.ends = next(
                (
                    ends
                    for ends in tried
                    if self._inside([*ends]) and self._clear([*ends]) and self._way(ends[0]) is not None
                ),
                None,
            )
        if self.ends is None:
            raise InputError(
                f"the motion of {self.plan.task.moved.name} to and fro has no clearance",
                expected="another place on the table, or a shorter tool",
            )
        return self.ends

    def _linear_ends(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the target positions, retracted; along the spindle: above the lower part, from the retracted position down."""
        axis = self.plan.task.axis
        levels = np.unique(self.plan.table.positions[:, axis])
        pose = min(self.contact_poses, key=lambda one: float(one.centre[axis]))
        first = self._retracted(pose)
        last = first.copy()
        if abs(self.plan.task.moved.machine_direction[2]) > ALONG:
            lowest = float(pose.at(self.machine, self.size.around_mm * pose.up)[axis])
            last[axis] = max(first[axis] - float(levels[-1] - levels[0]), lowest)
        else:
            first[axis], last[axis] = levels[0], levels[-1]
        yield first, last

    def _rotary_ends(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the ends of the range, then the outermost positions of the readings, with the tool retracted from each of the poses."""
        axis, angles = self.plan.task.axis, self.plan.task.angles_deg
        for low, high in (self.plan.task.base.kit.ranges[axis], (min(angles), max(angles))):
            for pose in self.contact_poses[: len(angles)]:
                first = self._retracted(pose)
                last = first.copy()
                first[axis], last[axis] = low, high
                yield first, last

    def _leave(self, number: int) -> None:
        """Retract from a part on the table."""
        if self.at_sphere:
            here = self.here
            pose = next(
                contact_pose for contact_pose in self.contact_poses if np.array_equal(contact_pose.centre, here)
            )
            self.steps.append(ProgramStep("feed", self._near(pose), number))
            self._moved(number, [self._retracted(pose)])
            self.at_sphere = False

    def _near(self, pose: ContactPose) -> np.ndarray:
        """Return the position beside a part at which rapid motion ends."""
        return pose.at(self.machine, self.size.around_mm * pose.up)

    def _way_to(self, number: int, high: np.ndarray) -> list[np.ndarray]:
        way = self._way(high)
        if way is None:
            raise _no_path(number)
        return [q for q in way if not (self.steps and np.array_equal(q, self.here))]

    def _moved(self, number: int, way: list[np.ndarray]) -> None:
        self.steps += [ProgramStep("rapid", q, number) for q in way]

    def _turned(self, number: int, speed: float) -> None:
        """Change the speed of the spindle; nothing before the first position."""
        if speed != self.speed and self.steps:
            self.steps.append(ProgramStep("spindle", self.here, number, rpm=speed))
            self.speed = speed

    def _waited(self, number: int, time: float) -> None:
        """Dwell until a time of the schedule."""
        self._count()
        left = time - self.elapsed if number > 1 else 0.0
        if number == 1:
            self.elapsed = 0.0
        self.latest_s = max(self.latest_s, -left)
        if left > LEAST_DWELL_S:
            self.steps.append(ProgramStep("dwell", self.here, number, seconds=round(left, 1)))
            self._count()

    def _count(self) -> None:
        """Add the time of the steps that were added since the last count."""
        for step in range(self.counted, len(self.steps)):
            one = self.steps[step]
            before = self.steps[step - 1].position if step else one.position
            if one.kind in ("dwell", "read"):
                self.elapsed += one.seconds
            elif one.kind in ("probe", "stop"):
                self.elapsed += CONTACT_S if one.kind == "probe" else STOP_S / 2.0
            elif one.kind in ("rapid", "feed"):
                self.elapsed += self._seconds([before, one.position], one.feed if one.kind == "feed" else np.inf)
        self.counted = len(self.steps)

    def _seconds(self, way: list[np.ndarray], feed: float = np.inf) -> float:
        """Return the time of moves at the speeds of the kit or at a feed."""
        total = 0.0
        for first, last in pairwise(way):
            travel = np.nan_to_num(np.abs(last - first))
            total += max(float(np.max(travel / self.task.kit.speeds)), 60.0 * float(np.linalg.norm(travel)) / feed)
        return total

    def _approach_s(self, pose: ContactPose) -> float:
        """Return the time from the retracted position to the part."""
        near = self._near(pose)
        return (
            0.0
            if self.probing
            else self._seconds([self._retracted(pose), near]) + self._seconds([near, pose.centre], APPROACH_FEED)
        )


def _no_path(number: int) -> InputError:
    return InputError(
        f"reading {number} of the drift test has no path with clearance",
        expected="another place on the table, another tool length, or a smaller clearance",
    )


def _drift_steps_header(plan: DriftPlan, builder: _DriftBuilder) -> list[str]:
    """Return the comments of the program."""
    base = plan.task.base
    places = ", ".join(f"{name} at x {x:g} y {y:g} z {z:g}" for name, (x, y, z) in base.places_mm.items())
    drift_steps_header = [
        "Program of a drift test by twin. NOT RUN ON A MACHINE: read it, run it dry, then with low override.",
        f"machine: {base.machine.name}; drift test {plan.sequence.name} with {plan.task.instrument}, {len(plan.table)} readings in "
        f"{plan.minutes:.0f} minutes",
        f"tool length {-base.tip_mm[2]:g} mm from the spindle nose to the {base.words.tip}; in the work frame, mm: {places}",
        "All positions are axis positions of the nominal machine without offsets, tool length or tool centre point control.",
        "Rotary axes must move by the difference of the programmed angles, not by the shorter way.",
        "Checked: ranges of the axes, and the shapes of the URDF with assumed tools and stems. NOT checked: holders, risers, clamps, "
        "cables, and the way to the first position.",
        "The dwells keep the times of the plan from the speeds of the kit: compare the clock with the comments of the readings.",
        f"equipment: {base.kit.source}",
    ]
    if builder.ends is not None:
        axis, (low, high) = plan.task.axis, builder.ends
        drift_steps_header.append(
            f"{plan.task.moved.name} moves to and fro from {low[axis]:g} to {high[axis]:g} at feed {plan.task.feed:g}."
        )
    if builder.latest_s > 1.0:
        drift_steps_header.append(
            f"The program is up to {builder.latest_s:.0f} s behind the plan: write the times at which the readings were taken."
        )
    if plan.task.instrument == "probe":
        drift_steps_header.append(f"Each reading: {CONTACTS} contacts.")
    else:
        drift_steps_header.append(
            "The instrument logs by itself, with its clock started at reading 1; the program only moves, waits and turns the spindle."
        )
    return drift_steps_header
