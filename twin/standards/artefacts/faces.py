"""Faces of an artefact that a dial gauge or a probe touches: square, 1-2-3 block, straightedge; all with reversal.

The plane has the axes a and b. The datum face runs along a and is touched along b, the blade runs along b and is touched along a. With
the artefact turned by ψ from a to b, and its angle larger than a right one by ε, in the nominal directions of the machine,

    datum: b = c + ψ a          blade: a = c′ − (ψ + ε) b

Turned over about a (`reversed`), the artefact has −ε: so both set-ups together show the squareness of the machine and that of the
artefact. The gauge points towards + or − (`plunger`) and reads more when its plunger is pushed in. A contact of a probe is the same
with a reading of zero and the position at the contact.

Reversal of a straightedge (ISO 230-1:2012, 8.2.2.1; equations 2.43 and 2.44 of Ellingsdalen 2021): turned by 180° about its length
together with the gauge, the readings are the sum and the difference of its own shape and the straightness of the axis.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.messages import Message
from twin.machine.machine import Machine
from twin.standards.artefacts.adjustment import BudgetLine, Linearised, Observed, RepeatedReadings
from twin.standards.artefacts.artefact import (
    EXPANSION,
    MACHINE,
    REPEAT,
    RESOLUTION,
    TEMPERATURE,
    ArtefactKind,
    LinearModel,
    capped,
    linear_model,
    plane_axes,
    positions,
    same,
    spans,
)
from twin.standards.artefacts.sheet import ArtefactSheet, SheetQuantity, SheetRow

SETUPS: Final = ("normal", "reversed")
POINTS: Final = 3
GAUGE: Final = SheetQuantity(
    "gauge per travel", "mm/m", 10.0, None, "limit of error of the gauge's scale; 1 %: 10 mm/m"
)
INCHES: Final = (25.4, 50.8, 76.2)
USUAL: Final = (200.0, 130.0)
"""Legs of a square of a workshop, mm; `LENGTH` of a straightedge."""
LENGTH: Final = 500.0


class _TwoFaces(ArtefactKind):
    """Artefact with faces at a right angle."""

    columns = ("setup", "face", "plunger")
    faces: ClassVar[tuple[tuple[str, int, int], ...]]
    """Name, axis of the plane along which it is touched, and direction in which the plunger points towards it."""

    @abstractmethod
    def offsets(
        self, sheet: ArtefactSheet, rows: Sequence[SheetRow]
    ) -> tuple[np.ndarray, np.ndarray, list[BudgetLine]]:
        """Return known offsets (m,) of the faces, columns (m, r) of unknown ones, and their contributions to the budget."""

    @abstractmethod
    def touched(
        self, row: SheetRow, model: LinearModel, normal: int, readings: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the commands (n,) of a row, and what the gauge read there, mm."""

    def observed(self, sheet: ArtefactSheet, machine: Machine) -> Observed:
        """See `ArtefactKind.observed`."""
        model = linear_model(machine)
        plane = plane_axes(sheet.plane, model)
        count = len(sheet.rows)
        towards, known = model.nominal / np.linalg.norm(model.nominal, axis=0), {face[0]: face for face in self.faces}
        signs, normals, at, groups = [], [], [], []
        for row in sheet.rows:
            _, axis, sign = known[row.word("face", list(known))]
            row.word("setup", SETUPS)
            letter = model.axes[plane[axis]]
            allowed = [f"{'+' if sign > 0 else '-'}{letter}"] if self.faces_fixed else [f"+{letter}", f"-{letter}"]
            word = row.word("plunger", allowed)
            signs.append(1.0 if word[0] == "+" else -1.0)
            normals.append(plane[axis])
            place, read = self.touched(row, model, plane[axis], row.readings)
            at.append(place)
            groups.append(read)
        places, side = np.array(at), np.array(signs)
        normal = towards[:, normals].T
        means = np.array([group.mean() for group in groups])
        known_offset, free, more = self.offsets(sheet, sheet.rows)
        blade = np.array(normals) == plane[0]
        running = towards[:, np.where(blade, plane[1], plane[0])].T
        setups = np.array([row.cells["setup"] for row in sheet.rows])[:, None] == np.array(SETUPS)
        turn = (
            setups * np.where(blade, -1.0, 1.0)[:, None]
        )  # of the surface, for a turn of each set-up, per running length
        angle = (
            np.where(blade, -1.0, 0.0)
            * np.where(setups[:, 0], 1.0, -1.0)
            * np.sum(running * (places @ model.nominal.T), axis=1)
        )
        self._check(sheet, normals, places, plane)
        repeats = RepeatedReadings.of(groups, sheet.value("repeatability"))
        effects = [
            BudgetLine(Message("artefact, angle"), 1e-3 * sheet.value("angle") * angle[None]),
            BudgetLine(Message("machine"), same(sheet.value("machine deviation"), count)),
            BudgetLine(Message("resolution"), same(repeats.rounding_mm(sheet.value("resolution")), count)),
            *more,
        ]

        def linearised(errors: np.ndarray) -> Linearised:
            there = places @ model.at(errors).T
            by = np.einsum("mi,pij,mj->mp", normal, model.derivatives, places)
            unknown = np.column_stack([free, turn * np.sum(running * there, axis=1)[:, None]])
            # The gauge shows the tool less the surface.
            return side * means - (np.sum(normal * there, axis=1) - known_offset), by, -unknown

        lines = tuple(row.line for row in sheet.rows)
        shown = np.array([row.readings.mean() for row in sheet.rows])
        return Observed(linearised, lines, shown, tuple(effects), repeats)

    faces_fixed: ClassVar[bool] = False

    def _check(self, sheet: ArtefactSheet, normals: Sequence[int], places: np.ndarray, plane: tuple[int, int]) -> None:
        """Raise `InputError` unless both directions were touched at two places each."""
        for axis, running in (plane, plane[::-1]):
            spread = max(
                (
                    np.ptp(
                        [
                            places[k, running]
                            for k, row in enumerate(sheet.rows)
                            if normals[k] == axis and (row.cells["setup"], row.cells["face"]) == key
                        ]
                    )
                    for key in {
                        (row.cells["setup"], row.cells["face"])
                        for k, row in enumerate(sheet.rows)
                        if normals[k] == axis
                    }
                ),
                default=0.0,
            )
            if spread <= 0.0:
                what = "a face needs readings at two places: no squareness without both directions"
                raise InputError(what, expected="two places or more on each face", file=sheet.path, value=sheet.plane)


@final
class Square(_TwoFaces):
    """Square and dial gauge, normal and turned over."""

    name = "square"
    title = Message("square and dial gauge")
    shows = Message("squareness of the plane; with both set-ups free of the square's own error")
    quantities = (
        SheetQuantity("angle", "mm/m", 0.2, None, "limit of error of the square; both set-ups make it unimportant"),
        RESOLUTION,
        GAUGE,
        MACHINE,
        REPEAT,
    )
    faces = (("datum", 1, 1), ("blade", 0, 1))

    def steps(self, plane: str) -> tuple[Message, ...]:
        """See `ArtefactKind.steps`."""
        a, b = plane[0], plane[1]
        return (
            Message(
                "Clamp the square on the table: one face (datum) runs along {a}, the other one (blade) along {b}.",
                a=a,
                b=b,
            ),
            Message(
                "Gauge in the spindle. Datum: move along {a}, the plunger points along {b}. Blade: move along {b}, it "
                "points along {a}.",
                a=a,
                b=b,
            ),
            Message(
                "plunger: the direction in which the plunger points at the face. The gauge reads more when it is pushed "
                "in."
            ),
            Message(
                "Reversed: turn the square over, so that its angle counts the other way, and touch the same two faces."
            ),
            Message("What was not measured stays empty."),
        )

    def rows(self, machine: Machine, plane: str, size_mm: tuple[float, ...]) -> list[dict[str, str]]:
        """See `ArtefactKind.rows`."""
        ends = spans(machine, plane, capped(machine, plane, size_mm, USUAL))
        found = []
        for setup in SETUPS:
            for name, normal, _ in self.faces:
                running = 1 - normal
                for q in np.linspace(*ends[running], POINTS):
                    at = {plane[running]: float(q)}
                    cells = {"setup": setup, "face": name, "plunger": f"+{plane[normal]}"}
                    found.append(cells | positions(machine, at))
        return found

    def touched(
        self, row: SheetRow, model: LinearModel, normal: int, readings: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `_TwoFaces.touched`."""
        return model.position(row), readings

    def offsets(
        self, sheet: ArtefactSheet, rows: Sequence[SheetRow]
    ) -> tuple[np.ndarray, np.ndarray, list[BudgetLine]]:
        """See `_TwoFaces.offsets`: the gauge is set anew on every face."""
        keys = [(row.cells["setup"], row.cells["face"], row.cells["plunger"]) for row in rows]
        free = np.array([[float(key == one) for one in dict.fromkeys(keys)] for key in keys])
        means = np.array([row.readings.mean() for row in rows])
        zero = free @ (np.linalg.pinv(free) @ means)
        for row, reading, middle in zip(rows, means, zero, strict=True):
            if abs(reading - middle) > 20.0:
                raise row.error(
                    "reading", "beyond the travel of a dial gauge", "mm of a gauge near zero", f"{reading:g} mm"
                )
        sign = np.array([1.0 if row.cells["plunger"][0] == "+" else -1.0 for row in rows])
        gain = BudgetLine(
            Message("gauge, scale"), (1e-3 * sheet.value("gauge per travel") * sign * (means - zero))[None]
        )
        return np.zeros(len(rows)), free, [gain]


@final
class GaugeBlock(_TwoFaces):
    """1-2-3 block and a probe: four faces, normal and turned over."""

    name = "block"
    title = Message("1-2-3 block and probe")
    shows = Message("squareness of the plane; scales, as good as its size allows (10 µm of 50 mm are 200 µm/m)")
    quantities = (
        SheetQuantity(
            "size",
            "mm",
            INCHES[2],
            0.005,
            "size of the block along the first axis of the plane (1-2-3 block: 76.2, 50.8 or 25.4)",
        ),
        SheetQuantity("second size", "mm", INCHES[1], 0.005, "size along the second axis"),
        SheetQuantity(
            "ball radius",
            "mm",
            1.0,
            0.005,
            "effective radius of the probe's ball, from a ring or a gauge block",
        ),
        SheetQuantity(
            "angle", "mm/m", 0.1, None, "limit of error of the block's right angle; both set-ups make it unimportant"
        ),
        EXPANSION,
        TEMPERATURE,
        RESOLUTION,
        MACHINE,
        REPEAT,
    )
    faces = (("left", 0, 1), ("right", 0, -1), ("front", 1, 1), ("back", 1, -1))
    faces_fixed = True

    def steps(self, plane: str) -> tuple[Message, ...]:
        """See `ArtefactKind.steps`."""
        a, b = plane[0], plane[1]
        return (
            Message(
                "Clamp the block, its first size along {a}, the second one along {b}; enter its sizes and the ball's "
                "radius above.",
                a=a,
                b=b,
            ),
            Message(
                "Touch each face where the rows say, in the direction of `plunger`. The reading is the position of {a} or "
                "{b} then.",
                a=a,
                b=b,
            ),
            Message(
                "Reversed: turn the block over about {a}, clamp it at the same place, and repeat. What was not measured "
                "stays empty.",
                a=a,
            ),
        )

    def statements(self, size_mm: tuple[float, ...]) -> list[str]:
        """See `ArtefactKind.statements`."""
        own = dict(zip(("size", "second size"), size_mm, strict=False))
        return [
            line
            for quantity in self.quantities
            for line in (f"#   {quantity.meaning}", quantity.text(own.get(quantity.key)))
        ]

    def rows(self, machine: Machine, plane: str, size_mm: tuple[float, ...]) -> list[dict[str, str]]:
        """See `ArtefactKind.rows`."""
        ends = spans(machine, plane, capped(machine, plane, size_mm, INCHES[:0:-1]))
        found = []
        for setup in SETUPS:
            for name, normal, sign in self.faces:
                running = 1 - normal
                low, high = ends[running]
                for q in np.linspace(low + 0.1 * (high - low), high - 0.1 * (high - low), POINTS):
                    face = ends[normal][0] if sign > 0 else ends[normal][1]
                    at = {plane[running]: float(q), plane[normal]: face - sign}
                    cells = {"setup": setup, "face": name, "plunger": f"{'+' if sign > 0 else '-'}{plane[normal]}"}
                    found.append(cells | positions(machine, at))
        return found

    def touched(
        self, row: SheetRow, model: LinearModel, normal: int, readings: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `_TwoFaces.touched`: the reading replaces the position; its repeats give the noise."""
        place, mean = model.position(row), float(readings.mean())
        axis = model.axes[normal]
        if abs(mean - row.number(f"{axis}_mm")) > 20.0:
            raise row.error(
                "reading",
                f"not a position of {axis} at this face",
                f"about {row.number(f'{axis}_mm'):g} mm",
                f"{mean:g} mm",
            )
        place[normal] = mean - model.origin[normal]
        return place, readings - mean

    def offsets(
        self, sheet: ArtefactSheet, rows: Sequence[SheetRow]
    ) -> tuple[np.ndarray, np.ndarray, list[BudgetLine]]:
        """See `_TwoFaces.offsets`: the ball's centre is half the block's size and a radius away from its middle."""
        keys = [(row.cells["setup"], row.cells["plunger"][1]) for row in rows]
        free = np.array([[float(key == one) for one in dict.fromkeys(keys)] for key in keys])
        side = np.array([-1.0 if row.cells["plunger"][0] == "+" else 1.0 for row in rows])
        first = np.array([row.cells["face"] in ("left", "right") for row in rows])
        warm = 1e-6 * sheet.value("expansion") * (sheet.value("temperature") - 20.0)
        half = 0.5 * np.where(first, sheet.value("size"), sheet.value("second size"))
        size = [0.5 * sheet.limit("size") * side * first, 0.5 * sheet.limit("second size") * side * ~first]
        warmth = [
            1e-6 * sheet.value("expansion") * sheet.limit("temperature") * side * half,
            1e-6 * sheet.limit("expansion") * (sheet.value("temperature") - 20.0) * side * half,
        ]
        more = [
            BudgetLine(Message("artefact, size"), np.array(size)),
            BudgetLine(Message("probe, radius"), (sheet.limit("ball radius") * side)[None]),
            BudgetLine(Message("temperature"), np.array(warmth)),
        ]
        return side * (half * (1.0 + warm) + sheet.value("ball radius")), free, more


@final
class Straightedge(ArtefactKind):
    """Straightedge and dial gauge with reversal: straightness of one axis."""

    name = "straightedge"
    title = Message("straightedge and dial gauge, reversed")
    shows = Message(
        "straightness of the first axis of the plane in the direction of the second; neither squareness nor scale"
    )
    quantities = (
        RESOLUTION,
        GAUGE,
        REPEAT,
        SheetQuantity(
            "sag",
            "mm",
            0.0,
            None,
            "limit of the straightedge's sag, which reversal does not show, where the gauge is vertical",
        ),
    )
    columns = ("setup", "plunger")

    def steps(self, plane: str) -> tuple[Message, ...]:
        """See `ArtefactKind.steps`."""
        a, b = plane[0], plane[1]
        return (
            Message(
                "Lay the straightedge along {a} on two supports, 0.22 of its length from the ends. The gauge touches it "
                "along +{b}.",
                a=a,
                b=b,
            ),
            Message(
                "Reversed: half a turn about its length, so that the same face is touched along -{b}, at the same places.",
                b=b,
            ),
            Message(
                "The gauge reads more when the plunger is pushed in. Both ends may read the same: set the zero as you "
                "like."
            ),
        )

    def rows(self, machine: Machine, plane: str, size_mm: tuple[float, ...]) -> list[dict[str, str]]:
        """See `ArtefactKind.rows`."""
        (span,) = spans(machine, plane[:1], capped(machine, plane[:1], size_mm, (LENGTH,)))
        return [
            {"setup": setup, "plunger": f"{sign}{plane[1]}"} | positions(machine, {plane[0]: float(q)})
            for setup, sign in zip(SETUPS, "+-", strict=True)
            for q in np.linspace(*span, 3 * POINTS)
        ]

    def observed(self, sheet: ArtefactSheet, machine: Machine) -> None:
        """See `ArtefactKind.observed`: a straightedge alone shows neither."""

    def separated(
        self, sheet: ArtefactSheet, machine: Machine
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return positions (n,) mm, straightness of the axis (n,) and shape of the straightedge (n,) in µm, u of both (n,) in µm.

        Both are deviations along the positive direction of the second axis of the plane, the shape in the normal set-up.
        """
        model = linear_model(machine)
        along, across = plane_axes(sheet.plane, model)
        letter = model.axes[across]
        found: dict[float, dict[str, SheetRow]] = {}
        for row in sheet.rows:
            row.word("plunger", [f"+{letter}", f"-{letter}"])
            pair = found.setdefault(row.number(f"{model.axes[along]}_mm"), {})
            setup = row.word("setup", SETUPS)
            if setup in pair:
                raise row.error("setup", "this place is there twice", "one row, with repeats in reading_1_mm …")
            pair[setup] = row
        for pair in found.values():
            if len(pair) < 2:
                row = next(iter(pair.values()))
                raise row.error("setup", "no reading of the other set-up at this place", "normal and reversed")
        at = np.array(sorted(found))
        if len(at) < POINTS:
            what = "too few places for a straightness"
            raise InputError(what, expected=f"{POINTS} or more", file=sheet.path, value=len(at))
        rows = [[found[float(q)][setup] for q in at] for setup in SETUPS]
        sides = [[1.0 if row.cells["plunger"][0] == "+" else -1.0 for row in own] for own in rows]
        reads = [np.array(side) * [row.readings.mean() for row in own] for side, own in zip(sides, rows, strict=True)]
        groups = [row.readings for own in rows for row in own]
        repeats = RepeatedReadings.of(groups, sheet.value("repeatability"))
        spread = repeats.spread.reshape(2, -1)
        line = np.column_stack([np.ones(len(at)), at])
        normal, reverse = (read - line @ (np.linalg.pinv(line) @ read) for read in reads)
        gain = 1e-3 * sheet.value("gauge per travel") * (np.abs(normal) + np.abs(reverse)) / 2.0
        parts = np.square(
            [repeats.rounding_mm(sheet.value("resolution")) / np.sqrt(6.0) + 0.0 * at, gain / np.sqrt(3.0)]
        )
        sag = sheet.value("sag") / np.sqrt(3.0)
        u = np.sqrt(0.25 * np.square(spread).sum(axis=0) + parts.sum(axis=0) + sag**2)
        return at, 500.0 * (normal + reverse), 500.0 * (reverse - normal), 1e3 * u
