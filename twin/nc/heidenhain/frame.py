"""Effects of Heidenhain blocks on the frame: preset, tool, tilted plane, shift and rotation."""

from __future__ import annotations

import math
import re
from typing import Final

from twin.nc.blocks import Plane, Rows, rotation_about
from twin.nc.heidenhain import vocabulary
from twin.nc.heidenhain.calls import PathBlock
from twin.nc.heidenhain.paths import HeidenhainPaths
from twin.nc.modal import Block
from twin.nc.text import MM_PER_INCH

_PRESET: Final = "Q339"
PLANES: Final = {"Z": (0, 1, 2), "Y": (2, 0, 1), "X": (1, 2, 0)}
_ANGLE: Final = re.compile(r"SP([ABC])[ \t]*([+-]?[ \t]*(?:[\d.,]+|Q[LR]?\d+))", re.ASCII | re.IGNORECASE)
_CHOICE: Final = re.compile(r"(?:SEQ|SYM)[ \t]*([+-])", re.ASCII | re.IGNORECASE)


class HeidenhainFrame(HeidenhainPaths):
    """Preset by cycle 247, tool by ``TOOL CALL``, tilted plane by ``PLANE SPATIAL``.

    Attributes:
        continued: whether the next line continues the current block (parameters of a cycle).
    """

    heidenhain = True
    continued = False
    plane = PLANES["Z"]
    _selects_preset = False
    _shift_below: tuple[float, ...] = ()
    _turned_deg = 0.0

    def lose(self, block: Block, statement: str) -> None:
        """As `Interpreter.lose`; the pole is unknown too, and a statement that the machine file names as harmless has no effect."""
        upper = " ".join(statement.split(";")[0].upper().split())
        if not any(f"{upper} ".startswith(f"{words} ") for words in self.harmless):
            super().lose(block, statement)
            self.centre = {}

    def begin_preset(self) -> None:
        """Begin cycle 247, whose parameter may follow on the next line."""
        if not self.offsets_known:
            self.note("CYCL DEF 247 selects a preset: its offset must be given as work_offset")
        self.assign(_PRESET, math.nan)
        self._selects_preset = True

    def end_preset(self, block: PathBlock) -> None:
        """Select the preset of a cycle 247 that is complete.

        Raises:
            InputError: its number is unknown.
        """
        if self._selects_preset and not self.continued:
            self._selects_preset = False
            self._shift_to(block, (), None)
            row = self.value_of(_PRESET)
            if not self.offsets_known and row != row:
                self.select_offset(block, f"preset of line {self._line + 1}")
                return
            if row != row or row != int(row):
                raise self.error("preset without a number", "Q339=+1 with the row of the preset table")
            self.select_offset(block, str(int(row)))

    def select_tool(self, block: PathBlock, body: str) -> None:
        """Put the tool of a ``TOOL CALL`` into the spindle.

        Raises:
            InputError: its number or ``DL`` is unknown.
        """
        match = vocabulary.TOOL.match(body)
        if match is None:
            return
        delta = vocabulary.TOOL_LENGTH.search(body.split(";")[0])
        tool = match.group(1) if match.group(2) is None else match.group(2)
        if not self.tools_known:
            row = self.value_of(tool)
            held = "" if row == 0.0 else f"{row:g}" if row == row else tool
            axis = vocabulary.TOOL_AXIS.match(body)
            along = None if axis is None else self.index.get(axis.group(1).upper())
            length = held and f"{held}{'' if delta is None else f' DL{delta.group(1)}'}"
            self.hold_tool(block, held, length, along=along)
            return
        if tool[:1] in "qQ":
            tool = f"{self.known('TOOL CALL', tool):g}"
        length = 0.0 if delta is None else self.known("DL", delta.group(1))
        self.select(block, tool=tool, length="" if tool == "0" else tool, delta_mm=length)

    def tilt(self, block: PathBlock, upper: str) -> None:
        """Apply ``PLANE SPATIAL`` or ``PLANE RESET``.

        Raises:
            InputError: another way to define a plane, or one that leaves the rotary axes to the program.
        """
        words = upper.split()
        if words[1:2] == ["RESET"]:
            if self.frame.plane is not None:
                if self.frame.shift or self.frame.turn:
                    raise self.error(
                        "end of a tilted plane while it is shifted or turned", "the shift cancelled before"
                    )
                self.select(block, plane=None, shift=self._shift_below)
            if "STAY" not in words:
                self.note("PLANE RESET may move the rotary axes; their positions are unknown afterwards")
                self.mark_unknown(block, range(self.linear, len(self.names)), moved=bool(self.frames))
            return
        if words[1:2] != ["SPATIAL"]:
            raise self.error("coordinate transformation PLANE", "PLANE SPATIAL with SPA, SPB and SPC")
        if self.tcp or self.frame.plane is not None:
            raise self.error("tilted plane within another", "M129 and PLANE RESET before it")
        if "STAY" in words or not {"TURN", "MOVE"} & set(words):
            raise self.error("PLANE SPATIAL that does not position the rotary axes", "TURN or MOVE")
        angles = {letter: self.known(f"SP{letter}", text) for letter, text in _ANGLE.findall(upper)}
        # About the fixed X, then Y, then Z: the same as about Z, then the turned Y, then the turned X.
        turned = rotation_about("ZYX", [angles.get(letter, 0.0) for letter in "CBA"])
        choice = _CHOICE.search(upper)
        sign = 0 if choice is None else 1 if choice.group(1) == "+" else -1
        stays = "TURN" in words and not any(word.startswith("MB") for word in words)
        self._shift_below = shift = self.frame.shift
        if self.frame.turn or any(shift[self.linear :]):
            raise self.error(
                "tilted plane in turned coordinates, or after a shift of a rotary axis", "these cancelled before"
            )
        x, y, z = shift[:3] or (0.0, 0.0, 0.0)
        self.select(block, plane=Plane((x, y, z), turned, sign, stays), shift=())

    def shift(self, block: PathBlock, words: str, what: str) -> None:
        """Shift the datum by axis words, each absolute or incremental (``IX``); the other axes keep their shift.

        Raises:
            InputError: other words, or a shift that cannot be followed.
        """
        shift = [*(self.frame.shift or (0.0,) * len(self.names))]
        found = list(vocabulary.SHIFT.finditer(words))
        if not found or vocabulary.SHIFT.sub("", words).strip():
            raise self.error(f"{what} without axis words", "axis words such as X+10 or IX+10", words.strip() or None)
        for match in found:
            axis = self.index.get(match[2].upper(), -1)
            if axis < 0:
                raise self.unknown_axis(match[0].strip())
            value = self.known(match[2], match[3]) * (MM_PER_INCH if self.inch and axis < self.linear else 1.0)
            shift[axis] = value + (shift[axis] if match[1] else 0.0)
        if self.frame.plane is not None and (self._shift_below or any(shift[self.linear :])):
            raise self.error(f"{what} in a tilted plane", "a shift of the linear axes, and none before the plane")
        if self.frame.turn and any(shift) and tuple(shift) != self.frame.shift:
            raise self.error(f"{what} in turned coordinates", "the rotation after the shift")
        self._shift_to(block, tuple(shift) if any(shift) else (), self.frame.turn)

    def turn(self, block: PathBlock, words: str, what: str) -> None:
        """Turn the coordinates in the working plane by ``ROT``, absolute or incremental.

        Raises:
            InputError: other words, or a rotation that cannot be followed.
        """
        match = vocabulary.ROTATION.fullmatch(words.strip())
        if match is None:
            raise self.error(f"{what} without an angle", "ROT+30", words.strip() or None)
        if self.plane != PLANES["Z"]:
            raise self.error(f"{what} about another axis than Z", "tool axis Z")
        angle = self.known("ROT", match[2])
        self._turned_deg = angle + (self._turned_deg if match[1] else 0.0)
        self._shift_to(block, self.frame.shift, rotation_about("Z", [self._turned_deg]) if self._turned_deg else None)

    def _shift_to(self, block: PathBlock, shift: tuple[float, ...], turn: Rows | None) -> None:
        if turn is None:
            self._turned_deg = 0.0
        if (shift, turn) != (self.frame.shift, self.frame.turn):
            self.centre = {}
        self.reframe(block, carried=False, shift=shift, turn=turn)

    def known(self, name: str, written: str) -> float:
        """Return the value of a word.

        Raises:
            InputError: it is unknown.
        """
        if "Q" in written.upper():
            return self.known_value(name, written, "a number, or a Q parameter set to a number before")
        value = self.value_of(written)
        if value != value:
            raise self.missing_number(name, written)
        return value
