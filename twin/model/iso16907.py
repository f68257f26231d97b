"""The classes of numerical compensation of ISO/TR 16907: the error motions of each, and how they are corrected.

The linear axes correct the functional point. The rotary axes correct the functional orientation (``FOR``); two of them cannot correct
every direction. ``R-POS`` moves the rotary axis itself by its own positioning error.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.errors import InputError, closest_name
from twin._common.families import BASIC, COMBINED, NAMES
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Machine
from twin.model.effects import ControlCorrection, Effect, split_name
from twin.model.effects.base import RecordingState

CONTROL: Final = "control"
"""Corrections that the control applies: not a class of errors, but accounted for separately."""


def iso_class(name: str, machine: Machine) -> str:
    """Return the basic class of an error motion, squareness or location by its ISO 230-1 name; ``control`` is returned unchanged."""
    if name == CONTROL:
        return CONTROL
    component, average, axis_name = split_name(name)
    axis = machine.by_name[axis_name]
    along = max(range(3), key=lambda i: abs(axis.direction[i]))
    if axis.linear:
        if average:
            return "L-SQU"
        return "L-ANG" if component >= 3 else "L-POS" if component == along else "L-STR"
    if average:
        return "R-POR"
    if component < 3:
        return "R-RAX"
    return "R-POS" if component - 3 == along else "R-ANG"


def error_motion_of(effect: Effect, machine: Machine) -> str:
    """Return the error motion to which an effect contributes: E_YY for backlash of Y.

    The name of an error motion, squareness or location is returned unchanged; for corrections of the control it is ``control``. If an
    effect acts along several directions of its frame, the largest component counts.
    """
    if effect.name.startswith("E_"):
        return effect.name
    if isinstance(effect, ControlCorrection):
        return CONTROL
    rates = effect.derivatives(RecordingState(machine))[0]
    largest = max(rates, key=lambda component: float(np.max(np.abs(rates[component]))))
    average = "0" if effect.frame.role == "location" else ""
    return f"E_{DIRECTIONS[largest]}{average}{effect.frame.axis}"


def is_angular(name: str) -> bool:
    """Return whether an error has an angular component (a squareness error has one, but turns the path and not the carried body)."""
    return split_name(name)[0] >= 3


@final
@dataclass(frozen=True)
class Scope:
    """Classes of errors that a compensation corrects.

    Attributes:
        classes: basic classes, corrected at the functional point.
        orientation: whether the functional orientation is corrected too (``FOR``).
        explicit: whether the user chose the scope; otherwise it is the default.

    Examples:
        >>> scope = twin.Scope.parse(["L-VOL", "R-POS"])
        >>> sorted(scope.classes)
        ['L-ANG', 'L-POS', 'L-SQU', 'L-STR', 'R-POS']
        >>> scope.orientation
        False

    References:
        - ISO/TR 16907:2015, Numerical compensation of geometric errors.
    """

    classes: frozenset[str]
    orientation: bool
    explicit: bool

    @classmethod
    def parse(cls, names: Iterable[str]) -> Scope:
        """Create a scope from class names, basic or combined.

        Raises:
            InputError: a name is unknown, or there is none.
        """
        classes: set[str] = set()
        for name in names:
            upper = name.strip().upper()
            if upper not in NAMES:
                raise InputError(
                    "no such class of ISO/TR 16907",
                    expected=f"some of {' '.join(NAMES)}",
                    value=name,
                    nearest=closest_name(upper, NAMES),
                )
            classes.update(COMBINED.get(upper, (upper,)))
        if not classes:
            raise InputError("an empty scope", expected=f"some of {' '.join(NAMES)}")
        return cls(frozenset(classes - {"FOR"}), "FOR" in classes, explicit=True)

    @classmethod
    def everything(cls, *, orientation: bool) -> Scope:
        """Return the default scope: all classes, and the orientation if the program moves rotary axes."""
        return cls(frozenset(BASIC), orientation, explicit=False)

    def at_point(self, name: str, machine: Machine) -> bool:
        """Return whether an error is corrected at the functional point."""
        return iso_class(name, machine) in self.classes

    def in_orientation(self, name: str, machine: Machine) -> bool:
        """Return whether an error is corrected by moving the rotary axes."""
        if self.orientation:
            return is_angular(name) and iso_class(name, machine) != "L-SQU"
        return iso_class(name, machine) == "R-POS" and "R-POS" in self.classes

    def covers(self, classes: Collection[str]) -> bool:
        """Return whether the scope contains all of the given classes (True) or none of them (False).

        Raises:
            InputError: it contains only some of them.
        """
        covered = [name for name in classes if name in self.classes]
        if covered and len(covered) < len(classes):
            raise InputError(
                "the tables of the control correct classes inside and outside the scope together and cannot be split: "
                "some errors would be corrected twice or not at all",
                expected=f"a scope with all of {' '.join(classes)}, or with none of them",
                value=str(self),
            )
        return bool(covered)

    def __str__(self) -> str:
        parts: list[str] = [name for name in BASIC if name in self.classes]
        for combined in ("L-VOL", "R-VOL"):
            if set(COMBINED[combined]) <= set(parts):
                parts = [combined if part == COMBINED[combined][0] else part for part in parts]
                parts = [part for part in parts if part not in COMBINED[combined]]
        return " ".join([*parts, *(["FOR"] if self.orientation else [])])
