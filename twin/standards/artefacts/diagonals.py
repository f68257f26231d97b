"""Two diagonals and the sides of a rectangle: marks made at four positions, the distances between them measured."""

from __future__ import annotations

from itertools import combinations
from typing import Final, final

import numpy as np

from twin._common.messages import Message
from twin.machine.machine import Machine
from twin.standards.artefacts.adjustment import BudgetLine, Linearised, Observed, RepeatedReadings
from twin.standards.artefacts.artefact import (
    NEAR,
    REPEAT,
    TEMPERATURE,
    ArtefactKind,
    linear_model,
    plane_axes,
    positions,
    same,
    spans,
)
from twin.standards.artefacts.sheet import ArtefactSheet, SheetQuantity

LENGTHS: Final = ("AC", "BD", "AB", "DC", "AD", "BC")
CORNERS: Final = {"A": (0, 0), "B": (1, 0), "C": (1, 1), "D": (0, 1)}
SLACK: Final = 1.0001
"""A triangle may be flat by this factor: readings have errors."""


@final
class Diagonals(ArtefactKind):
    """Squareness from the difference of two diagonals; scales from all lengths."""

    name = "diagonals"
    title = Message("diagonals of a rectangle")
    shows = Message("squareness of the plane; with the sides also both scales, as good as the ruler")
    quantities = (
        SheetQuantity("resolution", "mm", 0.5, None, "smallest step that can be read on the ruler"),
        SheetQuantity("instrument", "mm", 0.3, None, "limit of error of the ruler's zero, the same in all readings"),
        SheetQuantity(
            "instrument per length", "mm/m", 0.2, None, "limit of error of the ruler's scale (EU class II: 0.2 mm/m)"
        ),
        SheetQuantity("expansion", "µm/(m·K)", 11.5, 1.0, "thermal expansion of the ruler; iron alloys 11.5"),
        TEMPERATURE,
        SheetQuantity(
            "marks",
            "mm",
            0.05,
            None,
            "limit of where a mark is in each direction: drill wander and the machine's own deviations",
        ),
        SheetQuantity("repeatability", "mm", 0.2, None, REPEAT.meaning),
    )
    columns = ("length",)
    prefixes = ("from_", "to_")

    def steps(self, plane: str) -> tuple[Message, ...]:
        """See `ArtefactKind.steps`."""
        return (
            Message(
                "Drill or prick a mark at each of the four positions; approach every one from the same side. A is the "
                "corner at the lower {a} and {b}; B lies along {a}, D along {b}, C opposite.",
                a=plane[0],
                b=plane[1],
            ),
            Message(
                "Measure the six distances with one ruler or with calipers over pins; three times and not one after the "
                "other."
            ),
            Message(
                "Enter the readings. The two diagonals alone give the squareness; a length that was not measured stays "
                "empty."
            ),
        )

    def rows(self, machine: Machine, plane: str, size_mm: tuple[float, ...]) -> list[dict[str, str]]:
        """See `ArtefactKind.rows`."""
        ends = spans(machine, plane, size_mm)
        at = {
            name: {axis: end[one] for axis, end, one in zip(plane, ends, place, strict=True)}
            for name, place in CORNERS.items()
        }
        return [
            {"length": name} | positions(machine, at[name[0]], "from_") | positions(machine, at[name[1]], "to_")
            for name in LENGTHS
        ]

    def observed(self, sheet: ArtefactSheet, machine: Machine) -> Observed:
        """See `ArtefactKind.observed`."""
        model = linear_model(machine)
        plane_axes(sheet.plane, model)
        ends = [(model.position(row, "from_"), model.position(row, "to_")) for row in sheet.rows]
        moves = np.array([b - a for a, b in ends])
        nominal = np.linalg.norm(moves @ model.nominal.T, axis=1)
        groups = [row.readings for row in sheet.rows]
        means = np.array([group.mean() for group in groups])
        _check_triangles(sheet, ends, means)
        for row, length, group in zip(sheet.rows, nominal, groups, strict=True):
            if length < 1.0:
                raise row.error("length", "both marks are at the same position", "two positions")
            for reading in group:
                if abs(reading / length - 1.0) > NEAR:
                    raise row.error(
                        row.cells["length"],
                        "the reading does not fit the positions",
                        f"about {length:.1f} mm",
                        f"{reading:g} mm",
                    )
        warm = 1e-6 * sheet.value("expansion") * (sheet.value("temperature") - 20.0)
        lengths = means * (1.0 + warm)
        count = len(means)
        repeats = RepeatedReadings.of(groups, sheet.value("repeatability"))
        marks = {tuple(place.round(6)): place for pair in ends for place in pair}
        wander = np.zeros((len(marks), 3, count))
        for k, (a, b) in enumerate(ends):
            along = model.nominal @ moves[k] / nominal[k]
            for place, sign in ((a, -1.0), (b, 1.0)):
                wander[list(marks).index(tuple(place.round(6))), :, k] = sign * along
        effects = {
            Message("ruler, zero"): np.full((1, count), sheet.value("instrument")),
            Message("ruler, scale"): 1e-3 * sheet.value("instrument per length") * means[None],
            Message("temperature"): np.array(
                [
                    1e-6 * sheet.value("expansion") * sheet.limit("temperature") * means,
                    1e-6 * sheet.limit("expansion") * (sheet.value("temperature") - 20.0) * means,
                ]
            ),
            Message("marks"): sheet.value("marks") * wander.reshape(-1, count),
            Message("resolution"): same(repeats.rounding_mm(sheet.value("resolution")), count),
        }

        def at(errors: np.ndarray) -> Linearised:
            there = moves @ model.at(errors).T
            reach = np.linalg.norm(there, axis=1)
            by = np.einsum("mi,pij,mj->mp", there / reach[:, None], model.derivatives, moves)
            return lengths - reach, by, np.zeros((count, 0))

        return Observed(
            at,
            tuple(row.line for row in sheet.rows),
            means,
            tuple(BudgetLine(name, effect) for name, effect in effects.items()),
            repeats,
        )


def _check_triangles(sheet: ArtefactSheet, ends: list[tuple[np.ndarray, np.ndarray]], means: np.ndarray) -> None:
    """Raise `InputError` if three lengths between three marks cannot be a triangle."""
    sides = {}
    for k, (a, b) in enumerate(ends):
        key = frozenset({tuple(a.round(6)), tuple(b.round(6))})
        if key in sides:
            raise sheet.rows[k].error("length", "measured in two rows", "one row, with repeats in reading_1_mm …")
        sides[key] = k
    for marks in combinations({place for key in sides for place in key}, 3):
        own = [sides.get(frozenset(pair)) for pair in combinations(marks, 2)]
        if None in own:
            continue
        three = sorted((k for k in own if k is not None), key=lambda k: float(means[k]))
        longest, others = three[-1], three[:-1]
        if means[longest] > SLACK * means[others].sum():
            names = " + ".join(sheet.rows[k].cells["length"] for k in others)
            row = sheet.rows[longest]
            what = f"impossible: a side of a triangle is longer than the other two, {names}"
            raise row.error(
                row.cells["length"], what, f"less than {means[others].sum():.2f} mm", f"{means[longest]:g} mm"
            )
