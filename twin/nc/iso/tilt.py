"""Tilted planes of ISO programs: ``G68.2`` with ``G53.1`` (Fanuc), ``CYCLE800`` (SINUMERIK)."""

from __future__ import annotations

from typing import Final

from twin.nc.iso import vocabulary
from twin.nc.iso.block import IsoBlock, Item
from twin.nc.iso.frame import IsoFrame
from twin.nc.planes import Plane, rotation_about
from twin.nc.text import MM_PER_INCH

_ORDER: Final = {1: "X", 2: "Y", 3: "Z"}
_PLANE_WORDS: Final = tuple("XYZIJKPSTDHF")
_POSITIONING_WORDS: Final = tuple("PSTDHF")
"""Words of a block with G68.2, and with G53.1: those of the plane, and of spindle, tool and feed."""
_CHOICES: Final = {"0": 0, "1": 1, "2": -1}


class IsoTilt(IsoFrame):
    """The tilted plane in force, and one that is defined while the rotary axes are not yet positioned."""

    inch = False
    _defined: Plane | None = None

    def tilt_words(self, block: IsoBlock) -> None:
        """Apply ``G68.2``, ``G53.1`` and ``G69``, and take their words from a block.

        Raises:
            InputError: another way to define a plane, a plane within a plane, or an unknown value.
        """
        codes = {span.name for span in block.codes}
        words = _PLANE_WORDS if "68.2" in codes else _POSITIONING_WORDS
        stray = next((item for item in (*block.items, *block.others) if item.name not in words), None)
        if stray is not None and codes & {"68.2", "53.1"}:
            shown = block.text[stray.start : stray.end].strip()
            raise self.error("unknown word in a block with a tilted plane", f"no words but {' '.join(words)}", shown)
        if "68.2" in codes:
            self._check_allowed(block)
            values = {
                item.name: self._plane_value(item) for item in (*block.items, *block.others) if item.name in "XYZIJKP"
            }
            if values.pop("P", 0.0):
                raise self.error("G68.2 with P", "Euler angles I, J, K (without P)")
            unit = MM_PER_INCH if self.inch else 1.0
            x, y, z = (values.get(letter, 0.0) * unit for letter in "XYZ")
            turned = rotation_about("ZXZ", [values.get(letter, 0.0) for letter in "IJK"])
            self._defined = Plane((x, y, z), turned)
        elif "53.1" in codes:
            if self._defined is None:
                raise self.error("G53.1 without a tilted plane", "G68.2 before it")
            choice = next((item.value.strip() for item in block.others if item.name == "P"), "0")
            if choice not in _CHOICES:
                raise self.error("G53.1 with an unknown P", "P0, P1 or P2", choice)
            self._tilt(block, Plane(self._defined.origin_mm, self._defined.rotation, _CHOICES[choice]))
        elif "69" in codes:
            self._defined = None
            self.select(block, plane=None)
            return
        else:
            return
        block.items, block.others = [], []

    def swivel(self, block: IsoBlock, arguments: str) -> None:
        """Apply ``CYCLE800(FR, TC, ST, MODE, X0, Y0, Z0, A, B, C, X1, Y1, Z1, DIR, …)``.

        Raises:
            InputError: a form of the cycle whose effect is not modelled.
        """
        texts = [part.strip() for part in arguments.strip()[1:-1].split(",")]
        if not any(texts):
            self.select(block, plane=None)
            return
        self._check_allowed(block)
        shown = f"CYCLE800{arguments}"
        texts += [""] * (14 - len(texts))
        values = [self.value_of(text) if text else 0.0 for text in (texts[0], *texts[2:14])]
        if any(value != value for value in values):
            raise self.error("CYCLE800 with an unknown value", "numbers, or variables set to numbers before", shown)
        retract, new, mode = (int(value) for value in values[:3])
        order = "".join(_ORDER.get(mode >> shift & 3, "") for shift in (0, 2, 4))
        if mode >> 6 or len(order) != 3 or new % 10:
            expected = "rotations axis by axis (MODE 27, 39, 45, 54 or 57) of a new plane (ST 0)"
            raise self.error("CYCLE800 of this kind", expected, shown)
        if values[12] not in (-1.0, 1.0):
            raise self.error("CYCLE800 that does not position the rotary axes", "DIR 1 or -1", shown)
        unit = MM_PER_INCH if self.inch else 1.0
        turned = rotation_about(order, values[6:9])
        before, after = ([value * unit for value in values[i : i + 3]] for i in (3, 9))
        x, y, z = (
            before[i] + sum(part * value for part, value in zip(turned[i], after, strict=True)) for i in range(3)
        )
        self._tilt(block, Plane((x, y, z), turned, int(values[12]), stays=retract == 0))

    def check_plane(self, rotary: bool) -> None:
        """Raise `InputError` for a move that the tilted plane does not allow; ``rotary``: whether it names rotary axes."""
        if self._defined is not None:
            raise self.error("move between G68.2 and G53.1", "G53.1 directly after G68.2")
        super().check_plane(rotary)

    def _tilt(self, block: IsoBlock, plane: Plane) -> None:
        self._defined = None
        self.select(block, plane=plane)

    def _check_allowed(self, block: IsoBlock) -> None:
        if self.tcp:
            raise self.error("tilted plane under tool centre point control", "tool centre point control off before it")
        if self.frame.plane is not None:
            raise self.error("tilted plane within a tilted plane", "the first one cancelled (G69, CYCLE800()) before")

    def _plane_value(self, item: Item) -> float:
        return self.known_value(item.name, item.value, vocabulary.KNOWN_VALUE)
