"""Constant shifts and rotations of the coordinates of ISO programs.

``G92`` and ``G52``, values of work offsets by ``G10 L2`` and ``G10 L20``, and the programmable frame of SINUMERIK (``TRANS``, ``ROT``).

Sources: LinuxCNC user manual ("Coordinate systems", "G-Codes"), Fanuc Series 30i operator's manual ("Workpiece coordinate system",
"Local coordinate system"), SINUMERIK 840D sl Programming Manual Fundamentals ("Coordinate transformations (frames)").
"""

from __future__ import annotations

from typing import Any, Final, Literal

from twin.nc.blocks import AxisWords, Rows, WordFrame, product, rotation_about
from twin.nc.iso import vocabulary
from twin.nc.iso.cycles import Drilling
from twin.nc.iso.frame import IsoBlock, IsoTilt, Item
from twin.nc.modal import AxisWord
from twin.nc.text import MM_PER_INCH

PROGRAMMED: Final = frozenset({"TRANS", "ATRANS", "ROT", "AROT"})
"""Statements of SINUMERIK that shift or turn the coordinates."""
_GROUPS: Final = frozenset({"shift", "distance", "units", "plane", "feed"})
"""Groups of G words that a block with a shift may have."""
_OFFSETS: Final = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
"""The work offset of each P word of ``G10 L2``, from 1 on."""
_OF_LINUXCNC: Final = frozenset({"59.1", "59.2", "59.3", "92.2", "92.3", "38.2", "38.3", "38.4", "38.5"})
_OF_FANUC: Final = frozenset({"54.1", "154", "68.2", "65"})
_NOT_OF_SINUMERIK: Final = frozenset({*_OF_LINUXCNC, *_OF_FANUC, "20", "21", "28", "43", "49", "80", "98", "99"})
_BESIDE_OFFSET: Final = frozenset({"0", "1", "17", "18", "19", "20", "21", "40", "49", "69", "80", "90", "91", "94"})
"""G words without a P word of their own."""
_TURNED: Final = {17: 2, 18: 1, 19: 0}
Control = Literal["", "LinuxCNC", "Fanuc"]


class IsoShift(IsoTilt):
    """The shifts in force, and the values of work offsets that the program has set.

    Attributes:
        control: the control whose words the program has used so far, where the meaning of a word depends on it; empty if it is unknown.
    """

    plane: int
    incremental: bool
    code: str
    cycle: Drilling | None
    control: Control = ""
    _present: tuple[float, ...] = ()
    _saved: tuple[float, ...] | None = None
    _shifted_by = ""
    _programmed: tuple[tuple[float, ...], Rows | None] = (), None

    def __init__(self, source: str, axes: AxisWords, **how: Any) -> None:
        super().__init__(source, axes, **how)
        self._moved: dict[str, tuple[float, ...]] = {}
        self._turns: dict[str, Rows | None] = {}

    def shift_words(self, block: IsoBlock, groups: frozenset[str]) -> None:
        """Apply G10, G52, G92 and the end of the latter, and take their words from a block.

        Raises:
            InputError: a form of them that cannot be followed, or about which controls disagree.
        """
        code = next(span.name for span in block.codes if vocabulary.GROUP_OF[span.name] == "shift")
        what = f"G{code}"
        if code == "92" and not block.items and {item.name for item in block.others} == {"S"}:
            return  # highest spindle speed
        stray = [item for item in block.others if code != "10" or item.name not in "LPR"]
        if groups - _GROUPS or block.names or block.m_words or block.feed is not None or stray:
            raise self.error(f"{what} with other words", f"{what} and its axis words in a block of its own")
        self._check_shift(what)
        words = [self._declared(item) for item in block.items]
        given = {item.name: self.known_value(item.name, item.value, vocabulary.KNOWN_VALUE) for item in block.others}
        block.items, block.others = [], []
        if code == "10":
            self._set_offset(block, words, given)
        elif code in ("52", "92"):
            self._shift(block, code, words)
        elif words:
            raise self.error(f"{what} with axis words", f"{what} without them: controls differ")
        elif code == "92.3":
            if self._saved is None:
                raise self.error("G92.3 without a G92", "G92 with positions before it")
            self._present = self._saved
        else:
            self._saved = () if code == "92.1" else self._saved
            self._present = ()
        self._refresh(block)

    def _check_shift(self, what: str) -> None:
        """Raise `InputError` where a shift cannot be followed."""
        state = (
            (self.incremental and what in ("G10", "G52", "G92"), "in G91", "G90 before it"),
            (bool(self.code or self.cycle), "within a drilling cycle", "G80 before it"),
            (self.tcp, "under tool centre point control", "tool centre point control off before it"),
            (self.frame.plane is not None, "in a tilted plane", "G69 before it"),
            (any((*self._programmed,)), "after TRANS or ROT", "one of them"),
        )
        for found, where, expected in state:
            if found:
                raise self.error(f"{what} {where}", expected)

    def _declared(self, item: Item) -> AxisWord:
        axis = self.index[item.name]
        value = self.known_value(item.name, item.value, vocabulary.KNOWN_VALUE)
        value *= MM_PER_INCH if self.inch and axis < self.linear else 1.0
        return AxisWord(axis, item.start, item.end, item.value_start, item.value_end, "", False, value)

    def _shift(self, block: IsoBlock, code: str, words: list[AxisWord]) -> None:
        """Apply G92 or G52, which are one shift on LinuxCNC and two on Fanuc."""
        if any(self._present) and self._shifted_by != code:
            raise self.error(
                f"G{code} after G{self._shifted_by}", f"G{self._shifted_by} ended before it: controls differ"
            )
        if not words:
            raise self.error(f"G{code} without axis words", f"axis words, such as G{code} X0")
        present = [*(self._present or self._zeros)]
        for word in words:
            if code == "92":
                present[word.axis] += self._present_position(block, word) - word.value
            else:
                present[word.axis] = word.value
        self._present = self._saved = tuple(present)
        self._shifted_by = code

    def _present_position(self, block: IsoBlock, word: AxisWord) -> float:
        """Return the position that a word declares anew.

        Raises:
            InputError: it is unknown.
        """
        at, name = self.position[word.axis], self.names[word.axis]
        if at != at or self.unknown:
            what = f"{self._block_text.split()[0]} declares the present position of {name}, which is unknown"
            raise self.error(what, f"a move to a position of {name} before it")
        block.declared.append((word, at))
        return at

    def _set_offset(self, block: IsoBlock, words: list[AxisWord], given: dict[str, float]) -> None:
        """Apply ``G10 L2 P.. R..``: values of a work offset; ``G10 L20 P..``: LinuxCNC, so that the present position has values.

        Raises:
            InputError: another form.
        """
        kind, number, turn = given.get("L"), given.get("P", 0.0), given.get("R")
        if kind not in (2.0, 20.0):
            raise self.error("coordinate transformation G10", "G10 L2 with P and axis words")
        if number != int(number) or number < 1:
            raise self.error("G10 without the number of a work offset", "P1 to P9: for P0 controls differ", number)
        if kind == 20.0 and not (control := "Fanuc" if number > len(_OFFSETS) else self.control):
            what = "G10 L20 means the present position (LinuxCNC) or a further work offset (Fanuc)"
            raise self.error(what, "G10 L2, or a program with words of one of these controls before it")
        further = kind == 20.0 and control == "Fanuc"
        if number > len(_OFFSETS) and not further:
            raise self.error("G10 L2 with an unknown work offset", "P1 to P9", number)
        name = f"G54.1 P{int(number)}" if further else _OFFSETS[int(number) - 1]
        if kind == 2.0 or further:
            self.note(f"the program sets work offset {name}: its values replace those of the set-up", once=True)
            for one in (name, f"G154 P{int(number)}") if further else (name,):  # of Fanuc and of Haas
                self._state(one, words, turn)
            return
        if name != (self.offset or _OFFSETS[0]) or turn is not None or self.frame.turn is not None:
            expected = "the work offset in force, without rotation"
            raise self.error("G10 L20 for another work offset, or a turned one", expected, name)
        by = [*self._moved.get(name, self._zeros)]
        for word in words:
            by[word.axis] += self._present_position(block, word) - word.value
        self._moved[name] = tuple(by)

    def _state(self, name: str, words: list[AxisWord], turn: float | None) -> None:
        """Set values of a work offset, and its rotation about Z in degrees."""
        stated = [*self.stated_offsets.get(name, (None,) * len(self.names))]
        by = [*self._moved.get(name, self._zeros)]
        for word in words:
            stated[word.axis], by[word.axis] = word.value, 0.0
        self.stated_offsets[name], self._moved[name] = tuple(stated), tuple(by)
        if turn is not None and any(self._present):
            raise self.error("G10 L2 with R after G92", "G92.1 before it: LinuxCNC moves the axes then")
        if turn is not None:
            self._turns[name] = rotation_about("Z", [turn]) if turn else None

    @property
    def _zeros(self) -> tuple[float, ...]:
        return (0.0,) * len(self.names)

    def choose_offset(self, block: IsoBlock, code: str) -> None:
        """As `IsoFrame.choose_offset`, with the values that the program has set; ``G54 P3`` of Fanuc is ``G54.1 P3``."""
        others = {span.name for span in block.codes} - {"54"}
        if (
            code == "54"
            and not (self.code or others - _BESIDE_OFFSET)
            and any(item.name == "P" for item in block.others)
        ):
            code = "54.1"
        if self.code:
            what = "another work offset within a drilling cycle: R, the depth and the initial level are read in it, as by LinuxCNC"
            self.note(what, once=True)
        super().choose_offset(block, code)
        self._refresh(block)

    def _refresh(self, block: IsoBlock) -> None:
        """Put the shifts in force into the frame."""
        name = self.offset or _OFFSETS[0]
        shift, turn = self._programmed
        if not (shift or turn):
            turn = self._turns.get(name)
            by = zip(self._moved.get(name, self._zeros), self._turned(turn), strict=True)
            shift = tuple(one + other for one, other in by)
        stated = self.stated_offsets.get(name, ())
        stated = stated if any(value is not None for value in stated) else ()
        self.reframe(
            block, carried=not any(self._programmed), stated=stated, shift=shift if any(shift) else (), turn=turn
        )

    def _turned(self, turn: Rows | None) -> list[float]:
        """Return the shift by G92 or G52, which is along the turned axes, along those of the machine."""
        return WordFrame(turn=turn).converted(self._present or self._zeros, WordFrame())

    # ------------------------------------------------------------------ SINUMERIK

    def program_frame(self, block: IsoBlock, name: str) -> None:
        """Apply ``TRANS``, ``ATRANS``, ``ROT``, ``AROT``, or the end of a transformation, and take their words from a block.

        Raises:
            InputError: a form of them that cannot be followed.
        """
        added = name.startswith("A")
        if not (block.items or block.others):
            self._program(block, (), None)
            return
        if block.codes or len(block.names) > 1 or block.m_words or block.feed is not None or self.cycle is not None:
            raise self.error(f"{name} with other words, or within a cycle", f"{name} in a block of its own")
        if any((*self._present, *self._moved, *self.stated_offsets)):
            raise self.error(f"{name} after G92, G52 or G10", "one of them")
        shift, turn = self._programmed if added else ((), None)
        if name.endswith("TRANS"):
            if block.others:
                raise self.error(f"{name} with other words", f"axis words behind {name}")
            values = list(self._zeros)
            for word in map(self._declared, block.items):
                values[word.axis] = word.value
            along = WordFrame(turn=turn).converted(values, WordFrame())
            shift = tuple(one + other for one, other in zip(shift or self._zeros, along, strict=True))
        else:
            turn = product(turn, self._rotation(block, name))
        block.items, block.others = [], []
        self._program(block, shift, turn)

    def _rotation(self, block: IsoBlock, name: str) -> Rows | None:
        angles: dict[str, float] = {}
        for item in (*block.items, *block.others):
            axis = _TURNED[self.plane] if item.name == "RPL" else self.index.get(item.name, self.linear)
            if axis >= self.linear:
                raise self.error(f"{name} with other words", f"angles X, Y, Z or RPL behind {name}", item.name)
            letter = "XYZ"[axis]
            angles[letter] = self.known_value(item.name, item.value, vocabulary.KNOWN_VALUE)
        turns = [(letter, angle) for letter, angle in angles.items() if angle]
        if len(turns) > 1 or len(angles) < len(block.items) + len(block.others):
            raise self.error(
                f"{name} about several axes", "one axis a block: their order depends on the control's setting"
            )
        return rotation_about(turns[0][0], [turns[0][1]]) if turns else None

    def _program(self, block: IsoBlock, shift: tuple[float, ...], turn: Rows | None) -> None:
        shift = shift if any(shift) else ()
        if self.frame.plane is not None and any(shift[self.linear :]):
            raise self.error("shift of a rotary axis in a tilted plane", "shifts of the linear axes")
        ended = any(self._programmed)
        self._programmed = shift, turn
        if ended or shift or turn:
            self.reframe(block, carried=False, shift=shift, turn=turn)

    def tell_control(self, code: str) -> None:
        """Take a G code as a word of one control."""
        self.without_frames = self.without_frames or code in _NOT_OF_SINUMERIK
        if code in _OF_LINUXCNC:
            self.control = "LinuxCNC"
        elif code in _OF_FANUC:
            self.control = "Fanuc"
