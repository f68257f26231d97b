"""Effects of Heidenhain blocks on the frame: preset, tool, tilted plane, shift and rotation."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from twin.nc.blocks import Plane, Rows, product, rotation_about, rotation_along
from twin.nc.heidenhain import vocabulary
from twin.nc.heidenhain.calls import PathBlock
from twin.nc.heidenhain.paths import HeidenhainPaths
from twin.nc.modal import Block
from twin.nc.text import MM_PER_INCH

_PRESET: Final = "Q339"
PLANES: Final = {"Z": (0, 1, 2), "Y": (2, 0, 1), "X": (1, 2, 0)}
_DEFINITIONS: Final = {
    "SPATIAL": ("SPA", "SPB", "SPC"),
    "EULER": ("EULPR", "EULNU", "EULROT"),
    "VECTOR": ("BX", "BY", "BZ", "NX", "NY", "NZ"),
    "POINTS": tuple(f"P{point}{axis}" for point in (1, 2, 3) for axis in "XYZ"),
    "RELATIVE": ("SPA", "SPB", "SPC"),
}
"""Ways to define a plane, and their words."""
_PLANE_VALUE: Final = re.compile(
    r"(?<![A-Z\d])(SP[ABC]|EUL(?:PR|NU|ROT)|[BN][XYZ]|P[123][XYZ]|PRO(?:PR|MIN)|ROT)[ \t]*([+-]?[ \t]*(?:[\d.,]+|Q[LR]?\d+))",
    re.ASCII | re.IGNORECASE,
)
_ALONG: Final = 1e-12
_CHOICE: Final = re.compile(r"(?:SEQ|SYM)[ \t]*([+-])", re.ASCII | re.IGNORECASE)


class HeidenhainFrame(HeidenhainPaths):
    """Preset by cycle 247, tool by ``TOOL CALL``, tilted plane by ``PLANE SPATIAL``.

    Attributes:
        continued: whether the next line continues the current block (parameters of a cycle).
    """

    heidenhain = True
    variant = "HEIDENHAIN"
    continued = False
    plane = PLANES["Z"]
    pending: Plane | None = None
    _selects_preset = False
    _shift_below: tuple[float, ...] = ()
    _stated: frozenset[int] = frozenset()
    """Axes with an absolute shift since the shift became doubtful."""
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
            self._selects_preset, self.doubtful = False, ""
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
        """Apply a ``PLANE`` statement.

        Raises:
            InputError: another way to define a plane, or a plane where it cannot be followed.
        """
        words = upper.split()
        if words[1:2] == ["RESET"]:
            self._end_plane(block, words)
            return
        way = next((word for word in words if word in ("TURN", "MOVE", "STAY")), "")
        if self.tcp or not way:
            raise self.error(
                "PLANE under tool centre point control, or that says nothing of the rotary axes", "TURN, MOVE or STAY"
            )
        turned = self._rotation(upper, words[1] if len(words) > 1 else "")
        if turned[2][2] > 1.0 - _ALONG and turned[0][0] < 1.0 - _ALONG and "COORD ROT" not in upper:
            expected = "COORD ROT; TABLE ROT turns the table"
            raise self.error("PLANE that only turns about the tool axis", expected)
        choice = _CHOICE.search(upper)
        sign = 0 if choice is None else 1 if choice.group(1) == "+" else -1
        stays = way == "STAY" or ("TURN" in words and not any(word.startswith("MB") for word in words))
        self.pending = Plane(self._zero_of_plane(), turned, sign, stays)
        if way != "STAY":
            self._enter_plane(block, self.pending)

    def _zero_of_plane(self) -> tuple[float, float, float]:
        """Return the zero of a tilted plane: the datum shift before the first one.

        Raises:
            InputError: it is shifted or turned in a way that is not followed.
        """
        if self.frame.plane is None:
            self._shift_below = self.frame.shift
        elif self.frame.shift or self.frame.turn:
            raise self.error("another tilted plane while this one is shifted or turned", "the shift cancelled before")
        shift = self._shift_below
        if self.frame.turn or any(shift[self.linear :]):
            raise self.error(
                "tilted plane in turned coordinates, or after a shift of a rotary axis", "these cancelled before"
            )
        x, y, z = shift[:3] or (0.0, 0.0, 0.0)
        return x, y, z

    def working_plane(self, block: PathBlock, rest: str) -> None:
        """Apply ``CYCL DEF 19.1 A+30 B+0 C+15``, without angles its end; the program positions the rotary axes.

        The builder of the machine decides whether its angles are spatial angles or positions of the rotary axes (HEIDENHAIN, user's
        manuals of TNC 320 and iTNC 530, "Working plane, cycle 19"). Both must be the same plane.

        Raises:
            InputError: other words, or a plane where it cannot be followed.
        """
        found = vocabulary.TILT.findall(rest)
        if not vocabulary.TILT_REST.fullmatch(vocabulary.TILT.sub("", rest)):
            raise self.error("CYCL DEF 19 with other words", "angles such as A+30 B+0 C+15", rest)
        values = {name.upper(): self.known(name, text) for name, text in found}
        if not any(values.values()):
            if self.pending is not None or self.frame.plane is not None:
                self._end_plane(block, ())
            return
        if self.tcp:
            raise self.error("CYCL DEF 19 under tool centre point control", "M129 before it")
        turned = rotation_about("ZYX", [values.get(name, 0.0) for name in "CBA"])
        rotary = self.names[self.linear :]
        of_axes = {name for name, value in values.items() if value} <= {*rotary}
        read = tuple(values.get(name, 0.0) for name in rotary) if of_axes else None
        self.pending = Plane(self._zero_of_plane(), turned, read_deg=read)

    def _end_plane(self, block: PathBlock, words: Sequence[str]) -> None:
        """Apply ``PLANE RESET``; ``words``: those of the block."""
        self.pending = None
        if self.frame.plane is not None:
            if self.frame.shift or self.frame.turn:
                raise self.error("end of a tilted plane while it is shifted or turned", "the shift cancelled before")
            self.select(block, plane=None, shift=self._shift_below)
        if "STAY" not in words:
            self.note("the end of the plane may move the rotary axes; their positions are unknown afterwards")
            self.mark_unknown(block, range(self.linear, len(self.names)), moved=bool(self.frames))

    def _enter_plane(self, block: PathBlock, plane: Plane) -> None:
        self.pending = None
        self.select(block, plane=plane, shift=())

    def stand_at_plane(self, block: PathBlock) -> bool:
        """Apply a plane defined with ``STAY``; return whether a block does nothing else.

        Args:
            block: a block that moves axes. One that names rotary axes only positions them, by the parameters Q120 to Q122 where the
                control has computed them or by numbers; any other one finds them in position.

        Raises:
            InputError: it names both, some parameters only, or an unknown position, or under tool centre point control.
        """
        plane, rotary = self.pending, [word for word in block.words if word.axis >= self.linear]
        if plane is None:
            return False
        what = "move between PLANE with STAY and its positioning"
        if self.tcp or (rotary and (len(rotary) < len(block.words) or block.polar)):
            raise self.error(what, "the rotary axes alone, such as L A+Q120 C+Q122")
        computed = [word for word in rotary if word.form]
        if computed:
            if len(computed) < len(self.names) - self.linear:
                raise self.error(what, "every rotary axis by its own parameter, such as L A+Q120 C+Q122")
            self._enter_plane(block, plane)
            return True
        if rotary:
            self.apply_words(block)
        at = self.stands("tilted plane")
        self._enter_plane(block, replace(plane, at_deg=at))
        self.position[self.linear :] = at
        return bool(rotary)

    def _rotation(self, upper: str, way: str) -> Rows:
        """Return the rotation of a ``PLANE`` statement: its name and its words.

        Raises:
            InputError: another definition of a plane, or a value that is missing or unknown.
        """
        kind = next((name for name in _DEFINITIONS if way and name.startswith(way[:7]) and len(way) >= 5), "")
        if not kind:
            raise self.error(f"coordinate transformation PLANE {way}", f"PLANE {', '.join(_DEFINITIONS)}")
        values = {name: self.known(name, text) for name, text in _PLANE_VALUE.findall(upper)}
        wanted = _DEFINITIONS[kind]
        if not values.keys() <= {*wanted} or (kind in ("VECTOR", "POINTS", "EULER") and len(values) < len(wanted)):
            raise self.error(f"PLANE {way} with other words", " ".join(wanted))
        numbers = [values.get(name, 0.0) for name in wanted]
        if kind == "SPATIAL":
            # About the fixed X, then Y, then Z: the same as about Z, then the turned Y, then the turned X.
            return rotation_about("ZYX", numbers[::-1])
        if kind == "EULER":
            return rotation_about("ZXZ", numbers)
        if kind == "RELATIVE":
            if len(values) != 1:
                raise self.error("PLANE RELATIVE about several axes", "one of SPA, SPB and SPC")
            plane = self.frame.plane
            turned = rotation_about("XYZ", numbers)
            return turned if plane is None else product(plane.rotation, turned) or turned
        points = [numbers[i : i + 3] for i in range(0, len(numbers), 3)]
        if kind == "POINTS":
            x, y = ([b - a for a, b in zip(points[0], other, strict=True)] for other in points[1:])
            points = [x, [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]]
        try:
            return rotation_along(*points)
        except ValueError as error:
            raise self.error(f"PLANE {way} with {error}", "two directions across each other") from None

    def shift(self, block: PathBlock, words: str, what: str) -> None:
        """Shift the datum by axis words, each absolute or incremental (``IX``); the other axes keep their shift.

        Raises:
            InputError: other words, or a shift that cannot be followed.
        """
        if self.pending is not None:
            raise self.error(f"{what} between PLANE with STAY and its positioning", "the shift before it")
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
            if match[1] and self.doubtful:
                raise self.error(f"{what} by an increment where {self.doubtful}", "an absolute shift of X, Y and Z")
        self._stated |= {self.index[match[2].upper()] for match in found if not match[1]}
        if self.frame.plane is not None and self._shift_below and not any(shift):
            self.doubtful = "the datum shift from before the tilted plane is cancelled within it"
            self._stated = frozenset()
            return
        if self.frame.plane is not None and (self._shift_below or any(shift[self.linear :])):
            raise self.error(f"{what} in a tilted plane", "a shift of the linear axes, and none before the plane")
        if self.frame.turn and any(shift) and tuple(shift) != self.frame.shift:
            raise self.error(f"{what} in turned coordinates", "the rotation after the shift")
        self._shift_to(block, tuple(shift) if any(shift) else (), self.frame.turn)
        if self.frame.plane is None and self._stated >= {*range(self.linear)}:
            self.doubtful = ""

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
