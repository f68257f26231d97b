"""The classes of numerical compensation of ISO/TR 16907: which error motions each is about, and where it corrects them.

The functional point is corrected by the linear axes. The functional orientation (``FOR``) is corrected by the rotary axes,
as far as two of them can. ``R-POS`` moves the rotary axis itself by its own positioning error.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Final, final, get_args

import numpy as np

from twin._common.errors import InputError, nearest
from twin.display import card, pairs
from twin.machine.conditions import Listening
from twin.machine.control import BasicClass
from twin.machine.effects import ControlCorrection, Effect, split_name
from twin.machine.machine import DIRECTIONS, Machine

BASIC: Final[tuple[str, ...]] = get_args(BasicClass)
"""The classes every error motion belongs to exactly one of."""
CONTROL: Final = "control"
"""What the control takes out by itself: no class of errors, an account of its own."""
COMBINED: Final = {
    "L-VOL": ("L-POS", "L-STR", "L-SQU", "L-ANG"),
    "L-VOL+": ("L-POS", "L-STR", "L-SQU", "L-ANG", "FOR"),
    "R-VOL": ("R-POS", "R-RAX", "R-POR", "R-ANG"),
    "R-VOL+": ("R-POS", "R-RAX", "R-POR", "R-ANG", "FOR"),
}
NAMES: Final = (*BASIC, *COMBINED, "FOR")


def iso_class(name: str, machine: Machine) -> str:
    """The basic class of an error motion, squareness or location of a machine.

    Args:
        name: ISO 230-1 name, or ``control``, which is its own.
        machine: the machine it belongs to.
    """
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


def acts_as(effect: Effect, machine: Machine) -> str:
    """The error motion an effect is part of: a reversal of Y of E_YY. An error motion, squareness or location is itself.

    What the control takes out by itself is part of none: ``control``.

    Args:
        effect: the effect; where it acts along several directions of its frame, the largest counts.
        machine: the machine it belongs to.
    """
    if effect.name.startswith("E_"):
        return effect.name
    if isinstance(effect, ControlCorrection):
        return CONTROL
    rates = effect.derivatives(Listening(machine))[0]
    largest = max(rates, key=lambda component: float(np.max(np.abs(rates[component]))))
    average = "0" if effect.frame.role == "location" else ""
    return f"E_{DIRECTIONS[largest]}{average}{effect.frame.axis}"


def is_angular(name: str) -> bool:
    """Whether an error turns what it carries (squareness does not: it bends a path, not a body)."""
    return split_name(name)[0] >= 3


@final
@dataclass(frozen=True)
class Scope:
    """What a compensation is to correct.

    Attributes:
        classes: basic classes, corrected at the functional point.
        orientation: whether the functional orientation is corrected too (``FOR``).
        asked: whether the user chose it, or it is the default.
    """

    classes: frozenset[str]
    orientation: bool
    asked: bool

    @classmethod
    def parse(cls, names: Iterable[str]) -> Scope:
        """From class names, basic or combined.

        Raises:
            InputError: an unknown name, or none.
        """
        found: set[str] = set()
        for name in names:
            upper = name.strip().upper()
            if upper not in NAMES:
                raise InputError(
                    "no such class of ISO/TR 16907",
                    expected=f"--scope with some of {' '.join(NAMES)}",
                    value=name,
                    nearest=nearest(upper, NAMES),
                )
            found.update(COMBINED.get(upper, (upper,)))
        if not found:
            raise InputError("an empty scope", expected=f"--scope with some of {' '.join(NAMES)}")
        return cls(frozenset(found - {"FOR"}), "FOR" in found, asked=True)

    @classmethod
    def everything(cls, *, orientation: bool) -> Scope:
        """The default: all classes, and the orientation where the program moves rotary axes."""
        return cls(frozenset(BASIC), orientation, asked=False)

    def at_point(self, name: str, machine: Machine) -> bool:
        """Whether an error is corrected at the functional point."""
        return iso_class(name, machine) in self.classes

    def in_orientation(self, name: str, machine: Machine) -> bool:
        """Whether an error is corrected by moving the rotary axes."""
        if self.orientation:
            return is_angular(name) and iso_class(name, machine) != "L-SQU"
        return iso_class(name, machine) == "R-POS" and "R-POS" in self.classes

    def covers(self, classes: Collection[str]) -> bool:
        """Whether what is corrected holds all of some classes (True) or none of them (False).

        Raises:
            InputError: it holds some of them.
        """
        found = [name for name in classes if name in self.classes]
        if found and len(found) < len(classes):
            raise InputError(
                "the control's tables take out some classes that are in scope together with others that are not, and cannot be "
                "split: a program corrected so would be corrected twice, or not at all",
                expected=f"--scope with all of {' '.join(classes)}, or none of them",
                value=str(self),
            )
        return bool(found)

    def _repr_html_(self) -> str:
        rows = [
            ("at the functional point", ", ".join(name for name in BASIC if name in self.classes) or "nothing"),
            ("functional orientation", "corrected by the rotary axes (FOR)" if self.orientation else "as it is"),
        ]
        return card(f"Scope {self}", pairs(rows), small="asked for" if self.asked else "the default").text

    def __str__(self) -> str:
        parts: list[str] = [name for name in BASIC if name in self.classes]
        for combined in ("L-VOL", "R-VOL"):
            if set(COMBINED[combined]) <= set(parts):
                parts = [combined if part == COMBINED[combined][0] else part for part in parts]
                parts = [part for part in parts if part not in COMBINED[combined]]
        return " ".join([*parts, *(["FOR"] if self.orientation else [])])
