"""Balls of a known artefact, whose centres a probe finds: ball plate, and scale bar or ball bar with two balls.

The artefact may lie anywhere: translation and rotation of every placement are free unknowns. The reading of a ball are the positions of
the axes with the probe's tip at its centre, as the control's own cycle gives them.
"""

from __future__ import annotations

from itertools import pairwise
from typing import ClassVar, Final, final

import numpy as np

from twin._common.messages import Message
from twin.machine.machine import Machine
from twin.standards.artefacts.adjustment import BudgetLine, Linearised, Observed, RepeatedReadings
from twin.standards.artefacts.artefact import (
    EXPANSION,
    MACHINE,
    NEAR,
    REPEAT,
    RESOLUTION,
    TEMPERATURE,
    ArtefactKind,
    linear_model,
    plane_axes,
    spans,
)
from twin.standards.artefacts.sheet import ArtefactSheet, SheetQuantity, SheetRow

CERTIFICATE: Final = SheetQuantity(
    "places", "mm", 0.005, None, "limit of error of every ball's place, from the certificate or your own measurement"
)
LENGTH: Final = SheetQuantity("artefact scale", "mm/m", 0.02, None, "limit of error of the artefact's scale")
PLACE: Final = ("ball_x_mm", "ball_y_mm", "ball_z_mm")


class _Balls(ArtefactKind):
    """ArtefactKind with balls at known places."""

    columns = ("placement", "ball", "axis", *PLACE)
    quantities = (CERTIFICATE, LENGTH, EXPANSION, TEMPERATURE, RESOLUTION, MACHINE, REPEAT)
    least: ClassVar[int]

    def observed(self, sheet: ArtefactSheet, machine: Machine) -> Observed:
        """See `ArtefactKind.observed`; a row is one axis at one ball."""
        model = linear_model(machine)
        plane_axes(sheet.plane, model)
        found = _centres(sheet, model.axes)
        self._check_counts(found)
        rows = [row for balls in found.values() for own in balls.values() for row in own]
        count, size = len(rows), len(model.axes)
        readings = np.array([row.readings.mean() for row in rows]).reshape(-1, size) - model.origin
        places = np.array([[row.number(name) for name in PLACE] for row in rows[::size]])
        warm = 1e-6 * sheet.value("expansion") * (sheet.value("temperature") - 20.0)
        ends = np.cumsum([0, *map(len, found.values())])
        owns = [slice(int(a), int(b)) for a, b in pairwise(ends)]

        def laid(seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Return the places (balls, 3) as the placements are turned, and their rotations (balls, 3, 3)."""
            turns = np.concatenate([[_rotation(places[own], seen[own])] * (own.stop - own.start) for own in owns])
            middle = np.concatenate([[places[own].mean(axis=0)] * (own.stop - own.start) for own in owns])
            return np.einsum("bij,bj->bi", turns, places - middle) * (1.0 + warm), turns

        def free_of(turned: np.ndarray) -> np.ndarray:
            """Return the effects (3·balls, 6·placements) of shifts and turns of the placements."""
            free = np.zeros((3 * len(places), 6 * len(found)))
            for k, own in enumerate(owns):
                for i in range(3):
                    free[3 * own.start + i : 3 * own.stop : 3, 6 * k + i] = 1.0
                    free[3 * own.start : 3 * own.stop, 6 * k + 3 + i] = np.cross(np.eye(3)[i], turned[own]).ravel()
            return free

        turned, turns = laid(readings @ model.nominal.T)
        for own in owns:
            _check_distances(sheet, rows[::size][own], turned[own], readings[own] @ model.nominal.T)
        back = np.linalg.pinv(model.nominal)  # equations in the directions of the axes, one a row of the sheet

        def per_axis(effect: np.ndarray) -> np.ndarray:
            """Return effects (…, 3·balls) along x, y, z as effects along the axes, in the order of the rows."""
            split = effect.reshape(*effect.shape[:-1], -1, 3) @ back.T
            return np.asarray(split.reshape(*effect.shape[:-1], -1))

        repeats = RepeatedReadings.of([row.readings for row in rows], sheet.value("repeatability"))
        names = list(dict.fromkeys(row.cells["ball"] for row in rows))
        own_place = np.zeros((len(names), 3, len(places), 3))
        for k, row in enumerate(rows[::size]):
            own_place[names.index(row.cells["ball"]), :, k, :] = turns[k].T
        flat = turned.ravel()[None]
        effects = [
            BudgetLine(Message("artefact, places"), per_axis(sheet.value("places") * own_place.reshape(-1, flat.size))),
            BudgetLine(Message("artefact, scale"), per_axis(1e-3 * sheet.value("artefact scale") * flat)),
            BudgetLine(
                Message("temperature"), per_axis(1e-6 * sheet.value("expansion") * sheet.limit("temperature") * flat)
            ),
            BudgetLine(
                Message("expansion"),
                per_axis(1e-6 * sheet.limit("expansion") * (sheet.value("temperature") - 20.0) * flat),
            ),
            BudgetLine(Message("machine"), sheet.value("machine deviation") * np.eye(count)),
            BudgetLine(Message("resolution"), repeats.rounding_mm(sheet.value("resolution")) * np.eye(count)),
        ]

        def at(errors: np.ndarray) -> Linearised:
            there = readings @ model.at(errors).T
            by = np.einsum("pij,mj->pmi", model.derivatives, readings).reshape(len(model.names), -1)
            now, _ = laid(there)  # turned anew, so that the turn that is left is small
            return per_axis((now - there).ravel()), per_axis(by).T, -per_axis(free_of(now).T).T

        lines = tuple(row.line for row in rows)
        means = np.array([row.readings.mean() for row in rows])
        return Observed(at, lines, means, tuple(effects), repeats)

    def _check_counts(self, found: dict[str, dict[str, list[SheetRow]]]) -> None:
        """Raise `InputError` if a placement has too few balls."""
        for placement, balls in found.items():
            if len(balls) < self.least:
                what, row = f"placement {placement} has too few balls", next(iter(balls.values()))[0]
                raise row.error("placement", what, f"{self.least} or more")


def _centres(sheet: ArtefactSheet, axes: tuple[str, ...]) -> dict[str, dict[str, list[SheetRow]]]:
    """Return the rows by placement and ball, one for every axis in order; `InputError` if an axis is missing or there twice."""
    found: dict[str, dict[str, dict[str, SheetRow]]] = {}
    for row in sheet.rows:
        own = found.setdefault(row.cells["placement"], {}).setdefault(row.cells["ball"], {})
        axis = row.word("axis", axes)
        if axis in own:
            raise row.error("axis", "this ball and axis are there twice", "one row, with repeats in reading_1_mm …")
        own[axis] = row
    for balls in found.values():
        for own in balls.values():
            row = next(iter(own.values()))
            missing = [axis for axis in axes if axis not in own]
            if missing:
                raise row.error(
                    "axis", f"no reading of {' '.join(missing)} at this ball", f"readings of {' '.join(axes)}"
                )
            if any(other.cells[name] != row.cells[name] for other in own.values() for name in PLACE):
                raise row.error("ball_x_mm", "two places for one ball", "the same place in all its rows")
    return {
        placement: {ball: [own[axis] for axis in axes] for ball, own in balls.items()}
        for placement, balls in found.items()
    }


def _rotation(places: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) of places (n, 3) that is nearest to the readings (Kabsch)."""
    u, _, v = np.linalg.svd((places - places.mean(axis=0)).T @ (seen - seen.mean(axis=0)))
    return np.asarray(v.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T)


def _check_distances(sheet: ArtefactSheet, rows: list[SheetRow], places: np.ndarray, seen: np.ndarray) -> None:
    """Raise `InputError` if the distance of two balls is far from the artefact's."""
    for k in range(1, len(places)):
        known, read = (float(np.linalg.norm(one[k] - one[0])) for one in (places, seen))
        if known <= 0.0 or abs(read / known - 1.0) > NEAR:
            first = rows[0].cells["ball"]
            what = f"its distance from ball {first} does not fit the artefact"
            raise rows[k].error("ball", what, f"{known:.3f} mm", f"{read:.3f} mm")


@final
class ScaleBar(_Balls):
    """Bar with two balls: along the axes for scales, along both diagonals of a plane for squareness."""

    name = "scale-bar"
    title = Message("scale bar with two balls")
    shows = Message("scales along the axes; squareness of the plane from both diagonals")
    least = 2

    def steps(self, plane: str) -> tuple[Message, ...]:
        """See `ArtefactKind.steps`."""
        return (
            Message(
                "Clamp the bar along {a}, along {b}, and along both diagonals of {plane}; directions need not be"
                " exact.",
                a=plane[0],
                b=plane[1],
                plane=plane,
            ),
            Message(
                "Find the centre of each ball with the control's own probing cycle, three times. Readings are the "
                "positions of the axes."
            ),
            Message("ball_x_mm is the distance of the balls from the certificate, at 20 degC."),
        )

    def rows(self, machine: Machine, plane: str, size_mm: tuple[float, ...]) -> list[dict[str, str]]:
        """See `ArtefactKind.rows`."""
        length = size_mm[0] if size_mm else min(high - low for low, high in spans(machine, plane, ()))
        spans(machine, plane, (length, length))
        model = linear_model(machine)
        found = []
        for placement in (plane[0], plane[1], "diagonal +", "diagonal -"):
            for ball, at in (("1", 0.0), ("2", length)):
                for axis in model.axes:
                    place = dict(zip(PLACE, (f"{at:g}", "0", "0"), strict=True))
                    found.append({"placement": placement, "ball": ball, "axis": axis} | place)
        return found

    def all_columns(self, axes: object) -> tuple[str, ...]:
        """See `ArtefactKind.all_columns`: the positions are the readings."""
        return self.columns


@final
class BallPlate(_Balls):
    """Plate with balls or holes at known places."""

    name = "ball-plate"
    title = Message("ball plate")
    shows = Message("scales and squareness of the plane in one placement; of all planes with placements in each")
    least = 3

    def steps(self, plane: str) -> tuple[Message, ...]:
        """See `ArtefactKind.steps`."""
        return (
            Message(
                "Enter the places of the balls from the certificate (20 degC), in the plate's own frame; three rows for "
                "each ball."
            ),
            Message(
                "Clamp the plate in {plane}. Its direction need not be exact. Further placements get another name in "
                "`placement`.",
                plane=plane,
            ),
            Message(
                "Find the centre of each ball with the control's own probing cycle, three times. Readings are the "
                "positions of the axes."
            ),
        )

    def rows(self, machine: Machine, plane: str, size_mm: tuple[float, ...]) -> list[dict[str, str]]:
        """See `ArtefactKind.rows`."""
        ends = spans(machine, plane, size_mm)
        (a, b), model = (high - low for low, high in ends), linear_model(machine)
        found = []
        for k in range(9):
            x, y = (k % 3) * a / 2.0, (k // 3) * b / 2.0
            for axis in model.axes:
                place = dict(zip(PLACE, (f"{x:g}", f"{y:g}", "0"), strict=True))
                found.append({"placement": "1", "ball": str(k + 1), "axis": axis} | place)
        return found

    def all_columns(self, axes: object) -> tuple[str, ...]:
        """See `ArtefactKind.all_columns`: the positions are the readings."""
        return self.columns
