"""Values in ISO programs: numbers, variables that hold numbers, and the arguments of drilling cycles."""

from __future__ import annotations

import math
from typing import final

from twin.nc import iso_words as vocabulary
from twin.nc.iso_block import Drilling
from twin.nc.text import number


@final
class Variables:
    """The variables of a program whose value is a number in its text (``_X=5.``, ``R1=5``, ``#100=5``)."""

    def __init__(self) -> None:
        self._known: dict[str, float] = {}

    def value(self, text: str) -> float:
        """A number, or a variable whose number is known; NaN for anything else."""
        value = number(text)
        if value == value:
            return value
        match = vocabulary.REFERENCE.fullmatch(text)
        if match is None:
            return math.nan
        value = self._known.get(match.group(2).upper(), math.nan)
        return -value if match.group(1) == "-" else value

    def set(self, name: str, text: str) -> None:
        """Take an assignment; what is no number makes the variable unknown."""
        value = self.value(text)
        if value == value:
            self._known[name.upper()] = value
        else:
            self._known.pop(name.upper(), None)

    def declare(self, text: str) -> None:
        """Take the assignments in the rest of a ``DEF``."""
        for name, value in vocabulary.ASSIGNED.findall(text.split(";")[0]):
            self.set(name, value)

    def drilling(self, name: str, arguments: str, unit: float) -> Drilling | None:
        """The strokes of ``CYCLE81(RTP,RFP,SDIS,DP,DPR)`` or ``CYCLE82(.., DTB)``; None if they cannot be told.

        Args:
            name: the cycle.
            arguments: its argument list, with parentheses.
            unit: mm per program unit.
        """
        wanted = {"CYCLE81": 5, "CYCLE82": 6}.get(name)
        texts = [part.strip() for part in arguments[1:-1].split(",")]
        if wanted is None or not 4 <= len(texts) <= wanted:
            return None
        texts += [""] * (6 - len(texts))
        retract, reference, distance, depth, relative, dwell = (self.value(text) if text else 0.0 for text in texts)
        if not texts[3]:
            depth = reference - abs(relative)
        approach = reference + abs(distance)
        if not (depth < reference and retract >= approach and math.isfinite(dwell + depth)):
            return None
        pause = f"G4 F{texts[5]}" if dwell > 0 else ""
        return Drilling(approach * unit, depth * unit, pause, retract * unit)


def canonical(word: str) -> str:
    """A word as tables hold it: ``g01`` and ``G 1`` are ``G1``, ``G43.40`` is ``G43.4``."""
    word = word.strip().upper()
    if len(word) > 1 and word[0] in "GM":
        value = number(word[1:])
        if value == value and value >= 0:
            return f"{word[0]}{value:g}" if value < 1e5 else f"{word[0]}{value:.0f}"
        return word[0] if not word[1:2].isalpha() else word
    return word
