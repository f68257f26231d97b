"""Effects of Heidenhain blocks on the frame: preset, tool in the spindle, tilted plane."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Final

from twin.nc.block import Block
from twin.nc.heidenhain import vocabulary
from twin.nc.heidenhain.block import PathBlock
from twin.nc.modal import Interpreter
from twin.nc.planes import Plane, rotation_about

_PRESET: Final = "Q339"
_ANGLE: Final = re.compile(r"SP([ABC])[ \t]*([+-]?[ \t]*(?:[\d.,]+|Q[LR]?\d+))", re.ASCII | re.IGNORECASE)
_CHOICE: Final = re.compile(r"(?:SEQ|SYM)[ \t]*([+-])", re.ASCII | re.IGNORECASE)


class HeidenhainFrame(Interpreter):
    """Preset by cycle 247, tool by ``TOOL CALL``, tilted plane by ``PLANE SPATIAL``.

    Attributes:
        centre: the pole in force (``CC``), by axis.
        continued: whether the next line continues the current block (parameters of a cycle).
    """

    heidenhain = True
    continued = False
    _selects_preset = False
    centre: Mapping[int, float] = {}

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
        found = vocabulary.TOOL.match(body)
        if found is None:
            return
        delta = vocabulary.TOOL_LENGTH.search(body.split(";")[0])
        tool = found.group(1) if found.group(2) is None else found.group(2)
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
                self.select(block, plane=None)
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
        self.select(block, plane=Plane((0.0, 0.0, 0.0), turned, sign, stays))

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
