"""Modal state shared by the interpreters of ISO and Heidenhain blocks: positions, variables, notices, errors with their line."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

import numpy as np

from twin._common.errors import InputError
from twin.nc.arcs import ArcMisfit
from twin.nc.arithmetic import evaluate, key_of
from twin.nc.blocks import (
    NO_POSITION,
    Arc,
    AxisWords,
    FrameChange,
    Kind,
    LostPositions,
    Move,
    MoveColumns,
    Notice,
    WordFrame,
)
from twin.nc.text import LARGEST, NOT_IN_MODEL, AuxiliaryAxes, ProgramEnd, number, unit_vector


class AxisWord(NamedTuple):
    """One axis word of a block.

    Attributes:
        start, end: range of the word in the line's text.
        value_start, value_end: range of its value, inside ``AC( )`` and similar forms.
        form: ``""`` or ``AC``, ``IC``, ``DC``, ``ACP``, ``ACN``.
        incremental: whether the value is relative to the last position.
        value: as written, in mm or degrees; NaN if it is not a known number.
    """

    axis: int
    start: int
    end: int
    value_start: int
    value_end: int
    form: str
    incremental: bool
    value: float


class Span(NamedTuple):
    """A range of the line's text, and the name of the word in it."""

    start: int
    end: int
    name: str = ""


@dataclass(slots=True)
class Block:
    """One block: its words, the modal state in force, and its moves.

    Attributes:
        head_end: end of the skip mark and block number.
        incremental: whether words without a form are incremental here.
        axis_bits: the axes of these words, as bits.
        vector_words: ranges of the tool vector's values, by component 0, 1, 2.
        arc_words: centre, radius, sense and turns of an arc.
        end_m_words: M words that take effect at the end of the block.
        moves: none, one, or one move followed by the strokes of a drilling cycle.
        unknown_axes: indices of the axes whose position is unknown after the block.
        tcp_switched: whether the block switches tool centre point control.
        reframed: frames before and after a block that shifts or turns the coordinates; None for any other.
        declared: words that declare the present position; their values.
    """

    text: str
    head_end: int = 0
    inch: bool = False
    incremental: bool = False
    words: list[AxisWord] = field(default_factory=list)
    axis_bits: int = 0
    vector_words: dict[int, Span] = field(default_factory=dict)
    arc_words: list[Span] = field(default_factory=list)
    end_m_words: list[Span] = field(default_factory=list)
    moves: tuple[Move, ...] = ()
    unknown_axes: tuple[int, ...] = ()
    tcp_switched: bool = False
    reframed: tuple[WordFrame, WordFrame] | None = None
    declared: list[tuple[AxisWord, float]] = field(default_factory=list)


UNKNOWN_AFTER: Final = (
    "is not known: positions, frame, offsets and modes are unknown until machine coordinates of every axis"
)
"""End of the notice on a statement after which nothing is known."""
SWITCHING_M: Final = frozenset(
    (
        *range(21, 25),  # mirror images on some controls of Fanuc
        *(91, 92),  # machine coordinates (HEIDENHAIN)
        *(128, 129),  # tool centre point control on and off (HEIDENHAIN and others)
        *(428, 429, 430),  # kinematics switched (LinuxCNC's configurations)
    )
)
"""M functions that change coordinates or modes on a public control: nothing is known after them.

Every other one that is not known is an auxiliary function of the machine's builder by ISO 6983-1, which moves no axis and changes no
coordinates: it passes with a notice (`Interpreter.take_auxiliary`). A machine file can name those that are harmless, or that switch
tool centre point control.
"""
AUXILIARY: Final = (
    "is not known: taken as an auxiliary function of the machine's builder, which moves no axis and changes no coordinates; name it in "
    "the machine file (programs: harmless) if that is so"
)
"""End of the notice on an M word that is not known."""
CALLED_OUTSIDE: Final = (
    "is not given and is named as harmless: its call is left as written; it must leave positions, frame, offsets and modes "
    "unchanged"
)
"""End of the notice on a subprogram that is not given."""
SHORTEST_RULE: Final = 20
"""Equals signs of a line above and below the header that NX lists."""
UNKNOWN_AXIS: Final = "unknown axis"
BESIDE: Final = (
    "cutter radius compensation: the programmed points are corrected, arcs stay arcs and blocks stay whole; what the errors change "
    "over the radius of the tool, and along a block, is not corrected"
)
"""Notice on cutter radius compensation."""
CORRECTION_DEG: Final = 0.1
"""Turn of a rotary axis that is a correction rather than a motion of the program."""
_WITH_LETTER = re.compile(r"[A-Za-z_]")
"""An exponent, or what else Python reads as part of a number; no control does."""
_REFERENCE = re.compile(r"([+-]?)[ \t]*+(\$?[A-Za-z_]\w*+|\#(?:\d++|<[^>\r\n]*+>))", re.ASCII)


class Interpreter(ABC):
    """Modal state of an ISO or Heidenhain program; methods raise `InputError` (file, line, value) for what they cannot follow.

    Args:
        tcp_on, tcp_off: words that switch it, including those of the machine.

    Attributes:
        position: last commanded position, mm and degrees, NaN where unknown.
        vector: the tool vector in force, if orientation is given as one.
        notices, late_notices: remarks for the report; the second ones follow those of the whole program.
        lost_positions: lines after which axis positions are unknown.
        frame, frames: the coordinates in force, and the lines that change them.
        drilled: see `twin.nc.blocks.Interpretation`.
        stated_offsets: values of work offsets that the program has set, by axis; None for those that it has not.
        tcp_word: the word that switched it last; empty: none yet.
        motion: motion code in force, None before the first and in languages without.
        unknown: why positions, frame, offsets and modes are unknown here; empty if they are known.
        doubtful: why controls may differ in the shift of the coordinates; empty if it is known.
        offset: the work offset that the program has selected; None before the first, or if offsets do not change what is read.
        used_offset: the offset of the moves so far, None before the first.
        turned_to: (n, rotary axes) their positions before and at the moves checked last.
        repeated: moves of the third linear axis that follow each simple line, of a drilling cycle: height and whether it is a rapid;
            None if no cycle is in force.
    """

    heidenhain = False
    """Whether arithmetic is that of plain language."""
    motion: int | None = None
    beside = False
    repeated: tuple[tuple[float, bool], ...] | None = None
    unknown = ""
    doubtful = ""
    offset: str | None = None
    used_offset: str | None = None
    _offset_line = 0
    _inclined = False
    _listing = False

    def __init__(
        self, source: str, axes: AxisWords, *, tcp: bool, tcp_on: Iterable[str], tcp_off: Iterable[str]
    ) -> None:
        self.source = source
        self.names = axes.names
        self.index = {name.upper(): i for i, name in enumerate(self.names)}
        self.linear = len(axes.linear)
        self._rotary_increments = [axes.increment[name] for name in axes.rotary]
        self.inch = False
        self.position: list[float] = [math.nan] * len(self.names)
        self.vector: tuple[float, float, float] | None = None
        self.notices: list[Notice] = []
        self.late_notices: list[Notice] = []
        self.lost_positions: list[LostPositions] = []
        self.frame = WordFrame()
        self.frames: list[FrameChange] = []
        self.drilled: list[range] = []
        self.stated_offsets: dict[str, tuple[float | None, ...]] = {}
        self.offsets_known, self.tools_known = axes.offsets_known, axes.tools_known
        self._one_tool = axes.one_tool and not axes.tools_known
        self.tcp = tcp
        self.tcp_word = ""
        self.tcp_on = frozenset(tcp_on)
        self.tcp_off = frozenset(tcp_off) - self.tcp_on
        self.end = ProgramEnd()
        self._line = 0
        self._block_text = ""
        self._variables: dict[str, float] = {}
        self._named: dict[int, frozenset[str]] = {}
        self._noted: set[str] = set()
        self._placed: set[int] = set()
        self.harmless = frozenset(axes.harmless)
        self.references = dict(axes.references)
        self._held_tool = self._held_length = self._used_tool = self._used_length = ""
        self._fed_length: str | None = None
        self._tool_line = self._length_line = 0
        self._tool_chosen = False
        self._auxiliary: tuple[str, int] | None = None
        self.auxiliary_axes = AuxiliaryAxes(axes.auxiliary_axes)
        self.turned_to = np.full((1, len(self.names) - self.linear), np.nan)
        self.corners: list[tuple[str, int, bool, int]] = []
        """Paths left to the control among the lines just interpreted, as `shape_corner` has them, and their lines."""
        self.only_divided: set[int] = set()
        """Lines whose block could not stay whole."""

    @abstractmethod
    def moves(self, line: int, text: str) -> Sequence[Move]:
        """Return the moves of one line; ``line``: its 0-based index."""

    @property
    @abstractmethod
    def runs_allowed(self) -> bool:
        """Whether simple lines can be interpreted together in the present modal state."""

    def checked(self, moves: MoveColumns, text_of: Callable[[int], str]) -> MoveColumns:
        """Return the moves of the lines just interpreted; ``text_of``: the text of one of these lines by its 0-based index.

        It raises `InputError` for a feed that turns a rotary axis without tool centre point control behind an auxiliary function that
        is not known, which may be the machine's word for that control.
        """
        before = self.turned_to[-1:]
        self.turned_to = np.concatenate([before, moves.position[:, self.linear :]])
        if self._auxiliary:
            word, line = self._auxiliary
            turns = (np.abs(np.diff(self.turned_to, axis=0)) > CORRECTION_DEG).any(axis=1)
            for at in moves.line[turns & ~moves.rapid & ~moves.tcp & ~moves.passes & (moves.line >= line)][:1].tolist():
                raise self.error(
                    f"a feed turns a rotary axis without tool centre point control, and the effect of {word} (line {line + 1}) is not "
                    "known: it may switch that control",
                    f"{word} in the machine file, programs: {{harmless: [{word}]}} or {{tcp_on: [{word}]}}",
                    text_of(at).strip(),
                    at + 1,
                )
        return moves

    def shape_corner(self, name: str, behind: int, *, both: bool) -> None:
        """Leave a path between blocks to the control, which finds it from them: they stay whole, their ends are corrected.

        ``name``: of the statement; ``behind``: the first line behind the block that leads to the corner; ``both``: whether the block
        that follows stays whole, too.
        """
        self.note(f"{name} is left to the control: the points beside it are corrected", once=True)
        self.corners.append((name, behind, both, self._line))

    def is_listing(self, text: str) -> bool:
        """Return whether a line is in the listing of a CAM system above a program, from a line of equals signs to the next one."""
        rule = not text.strip("=") and len(text) >= SHORTEST_RULE
        inside = self._listing
        if rule and (inside or self._line == 0):
            self._listing = not inside
            self.note("the listing above the program is left as written: a control does not read it", once=True)
        return inside or self._listing

    def may_end(self, tail: str) -> bool:
        """Return whether a program may be divided here; ``tail``: its lines after the last move."""
        return True

    def behind_end(self, *, moves: bool) -> None:
        """Take note of a block behind the end of the program; raise `InputError` if it moves axes, and the control may execute it."""
        refused = self.end.refusal() if moves else None
        if refused is not None:
            raise self.error(*refused)
        self.note(self.end.notice, once=True)

    # ------------------------------------------------------------------ messages

    def error(self, what: str, expected: str, value: object = None, line: int | None = None) -> InputError:
        """Return an error at the current line; ``value``: the offending text, the whole block if None."""
        shown = self._block_text.strip() if value is None else value
        return InputError(what, expected=expected, file=self.source, line=line or self._line + 1, value=shown)

    def note(self, text: str, *, once: bool = False) -> None:
        """Add a notice at the current line; ``once``: only if the program has no such notice yet."""
        if not (once and text in self._noted):
            self._noted.add(text)
            self.notices.append(Notice(self._line, text))

    def missing_number(self, name: str, written: str) -> InputError:
        """Return the error for a word without a number."""
        return self.error(f"{name} has no number", "a number such as 12.5", f"{name}{written}")

    def unknown_axis(self, shown: str) -> InputError:
        """Return the error for an axis that this machine does not have."""
        name = shown[:1].upper()
        expected = f"one of this machine's axes ({', '.join(self.names)}), or {name} named as an auxiliary axis that stands still"
        return self.error(UNKNOWN_AXIS, expected, shown)

    # ------------------------------------------------------------------ values

    def value_of(self, text: str) -> float:
        """Return the value of a number, or of arithmetic with variables of known values; NaN for anything else."""
        value = number(text)
        if value == value and not _WITH_LETTER.search(text):
            return value
        match = _REFERENCE.fullmatch(text)
        if match is None:
            value = evaluate(text, self._variables, heidenhain=self.heidenhain)
            return value if -LARGEST < value < LARGEST else math.nan
        value = self._variables.get(key_of(match.group(2)), math.nan)
        return -value if match.group(1) == "-" else value

    def known_value(self, name: str, text: str, expected: str) -> float:
        """Return the value of a word; raise `InputError` if it is unknown. ``expected``: what it should be, for the message."""
        value = self.value_of(text)
        if value != value:
            raise self.error(f"the value of {name} is unknown", expected, text)
        return value

    def assign(self, name: str, value: float) -> None:
        """Set a variable; NaN makes it unknown."""
        self._variables[key_of(name)] = value

    def named(self, bits: int) -> frozenset[str]:
        """Return the names of the axes given as bits."""
        names = self._named.get(bits)
        if names is None:
            names = self._named[bits] = frozenset(name for i, name in enumerate(self.names) if bits >> i & 1)
        return names

    def add(self, block: Block, word: AxisWord) -> None:
        """Add an axis word to a block; raise `InputError` if it already has one for that axis."""
        if block.axis_bits >> word.axis & 1:
            raise self.error(f"axis {self.names[word.axis]} twice in one block", "each axis once")
        block.axis_bits |= 1 << word.axis
        block.words.append(word)

    # ------------------------------------------------------------------ state

    def mark_unknown(
        self, block: Block, which: Iterable[int], *, moved: bool | None = False, reference: str = ""
    ) -> None:
        """Mark axis positions as unknown after a block.

        ``moved``: True: the block moves them; False: it may; None: it does not, or moves them to a known place. ``reference``: the word
        of a reference return that moves them.
        """
        axes = tuple(which)
        if moved is not None:
            self.lost_positions.append(LostPositions(self._line, axes, moved, reference))
        block.unknown_axes = tuple(sorted({*block.unknown_axes, *axes})) if block.unknown_axes else axes
        for axis in axes:
            self.position[axis] = math.nan

    def lose(self, block: Block, statement: str) -> None:
        """Make positions, frame, offsets and modes unknown from a block on, because the effect of a statement is not known.

        They are known again when every axis has been given an absolute position in machine coordinates.
        """
        shown = " ".join(statement.split())[:60]
        self.note(f"the effect of {shown} {UNKNOWN_AFTER}")
        self.unknown = self.unknown or f"the effect of {shown} is not known"
        self._placed.clear()
        self.vector = None
        self.mark_unknown(block, range(len(self.names)), moved=True)

    def take_auxiliary(self, word: str) -> None:
        """Pass an M word of the machine's builder on: it is taken as an auxiliary function, with a notice."""
        self.note(f"{word} {AUXILIARY}")
        if self._auxiliary is None:
            self._auxiliary = word, self._line

    def call_outside(self, *names: str) -> None:
        """Pass the call of a subprogram that is not given; raise `InputError` unless one of its names is named as harmless."""
        if self.harmless.isdisjoint(name.upper() for name in names):
            expected = f"it in this file, beside it or in a folder of subprograms; or {names[-1]} named as harmless"
            raise self.error(
                f"no subprogram {names[0]}", f"{expected}, if it leaves positions, frame and modes unchanged"
            )
        self.note(f"{names[0]} {CALLED_OUTSIDE}", once=True)

    def take_auxiliary_axis(self, name: str, value: float | str, *, incremental: bool, feeds: bool) -> None:
        """Take the word of an auxiliary axis (`AuxiliaryAxes.move`); raise `InputError` for a feed that moves it."""
        if self.auxiliary_axes.move(name, value, incremental=incremental) and feeds:
            what = f"feed of {name}, which is not in the model of the machine"
            raise self.error(what, f"a rapid to a position of {name} before it")
        self.note(f"{name} {NOT_IN_MODEL}", once=True)

    def unknown_move(self, kind: Kind, axis_bits: int) -> Move:
        """Return the move of a block that names some axes (bits) where nothing is known."""
        self.position = [math.nan] * len(self.names)
        return Move(self._line, kind, self.tcp, tuple(self.position), self.named(axis_bits), unknown=self.unknown)

    def arc_from_unknown(self, block: Block, start: Sequence[float], plane: Sequence[int]) -> bool:
        """Add the move of an arc whose start is not known, which passes through; return whether it is one.

        ``start``: the position before it, ``plane``: its two axes. Under cutter radius compensation it is not one: the arc is refused.
        """
        missing = [self.names[axis] for axis in plane if start[axis] != start[axis]]
        if not missing or self.beside:
            return False
        reason, end = f"{NO_POSITION} {', '.join(missing)}", tuple(self.position)
        block.moves += (Move(self._line, Kind.ARC, self.tcp, end, self.named(block.axis_bits), unknown=reason),)
        block.unknown_axes = tuple(range(len(self.names)))
        return True

    def _place(self, position: Sequence[float]) -> None:
        """Take machine coordinates into account where nothing is known; NaN for axes without any."""
        self._placed |= {axis for axis, value in enumerate(position) if value == value}
        if len(self._placed) == len(self.names):
            self.unknown = ""
            self.note(
                "positions are known again; work offset, units and modes are taken as the program has selected them"
            )

    def select_offset(self, block: Block, name: str) -> None:
        """Select a work offset by its name; positions in the new coordinates are unknown where the offsets are known."""
        if self.offset not in (None, name):
            self.check_beside()
        self.offset, self._offset_line = name, self._line
        if self.offsets_known:
            self.used_offset = name
            self.select(block, offset=name)

    def use_offset(self) -> None:
        """Record that a move uses the work offset in force; a second one of unknown values is refused (rapids in it: `parks`)."""
        if self.doubtful:
            what = f"move where {self.doubtful}"
            raise self.error(what, "that stated before it, in a way that every control reads alike")
        if self._offset_known:
            return
        if self.used_offset is not None:
            expected = (
                f"only rapids in another work offset than before ({self.used_offset}), or the table of work offsets"
            )
            raise self.error("second work offset", expected, self.offset, self._offset_line + 1)
        self.used_offset = self.offset

    @property
    def parks(self) -> bool:
        """Whether a rapid goes to an unknown place: in a second work offset of unknown values, or after a doubtful shift."""
        return bool(self.doubtful) or (self.used_offset is not None and not self._offset_known)

    def parking_move(self, block: Block) -> Move:
        """Return the rapid of a block that `parks`; it passes through unchanged."""
        position = self.machine_position(block, elsewhere=True)
        if self._offset_known:  # what is doubtful does not shift rotary axes
            for word in block.words:
                if word.axis >= self.linear and not word.incremental:
                    self.position[word.axis] = word.value
        unknown = self.doubtful or f"the value of work offset {self.offset} is not known"
        return Move(
            self._line, Kind.RAPID, self.tcp, position, self.named(block.axis_bits), machine=True, unknown=unknown
        )

    @property
    def _offset_known(self) -> bool:
        """Whether moves may use the work offset in force: that of the moves before, or one whose values the program has set."""
        stated = self.stated_offsets.get(self.offset or "", (None,))
        return self.offset in (None, self.used_offset) or None not in stated

    def hold_tool(self, block: Block, tool: str, length: str, *, along: int | None = None) -> None:
        """Record the tool in the spindle and the one whose length is in force, empty for none, where lengths are not known.

        After a change the axis ``along`` the tool, the third one if None, is at an unknown position: its words then count with another
        length, and on some controls an incremental word moves by the difference, too. A switch of tool centre point control is another
        matter (`switch`).
        """
        if (tool, length) != (self._held_tool, self._held_length) and not block.tcp_switched:
            axes = (self.linear - 1 if along is None else along,)
            self.lost_positions.append(LostPositions(self._line - 1, axes, True))  # before the words of this block
            self.mark_unknown(block, axes if self.frame.plane else self.words_of(axes), moved=None)
        if tool != self._held_tool:
            self._held_tool, self._tool_line, self._tool_chosen = tool, self._line, True
        if length != self._held_length:
            self._held_length, self._length_line, self._tool_chosen = length, self._line, True

    def use_set_up(self, kind: Kind) -> None:
        """Record that a move uses the work offset, the tool and the length in force."""
        self.use_offset()
        if self.auxiliary_axes.moved and kind is not Kind.RAPID and (wrong := self.auxiliary_axes.feed()):
            raise self.error(
                wrong, "one position in all feeds: what this axis moves is not in the model of the machine"
            )
        self.use_tool(cutting=kind is not Kind.RAPID)

    def use_tool(self, *, cutting: bool) -> None:
        """Record that a move, a feed if ``cutting``, uses the tool and the length in force; a second unknown one is refused."""
        if not self._one_tool:
            return
        for what, now, before, line in (
            ("second tool", self._held_tool, self._used_tool, self._tool_line),
            ("second tool length", self._held_length, self._used_length, self._length_line),
        ):
            if now and before and now != before:
                expected = f"one tool of one length per program (moves before use {before}), or the table of tools"
                raise self.error(what, expected, now, line + 1)
        self._used_tool, self._used_length = self._held_tool or self._used_tool, self._held_length or self._used_length
        self._tool_chosen = False
        if cutting and not self.tcp:
            if self._fed_length not in (None, self._held_length):
                expected = "one tool length in force at all feed moves, or the table of tools"
                raise self.error("feed moves with and without a tool length", expected)
            self._fed_length = self._held_length

    @property
    def set_up(self) -> bool:
        """Whether work offset, tool and length are those of the moves before, and everything is known."""
        same_tool = not self._one_tool or not (
            self._tool_chosen or (self._fed_length != self._held_length and not self.tcp)
        )
        same_offset = self.offset == self.used_offset or self._offset_known
        return same_tool and same_offset and not (self.unknown or self.doubtful or self.auxiliary_axes.moved)

    def check_plane(self, rotary: bool, *, machine: bool = False) -> None:
        """Raise `InputError` for a move that the plane does not allow; ``rotary``: it names rotary axes, ``machine``: coordinates."""
        if (rotary or not machine) and not self.plane_allows(rotary):
            what = "rotary axes or tool centre point control in a tilted plane"
            cancel = "PLANE RESET" if self.heidenhain else "G69 or CYCLE800()"
            raise self.error(what, f"positions of the linear axes; {cancel} before")

    def plane_allows(self, rotary: bool) -> bool:
        """Return whether the tilted plane in force, if any, allows a move, and take it into account; ``rotary``: as `check_plane`.

        HEIDENHAIN (TNC 640, user's manual, "Inclined-tool machining in the tilted plane"): with tool centre point control, positions of
        the tool tip stay in the tilted coordinates, and words of rotary axes are those of the axes. Without it again, coordinates where
        the tool is inclined to the plane are not followed.
        """
        if self.frame.plane is None:
            return True
        if self.heidenhain and self.tcp:
            self._inclined = self._inclined or rotary
            return True
        return not (rotary or self.tcp or self._inclined)

    def stands(self, what: str) -> tuple[float, ...]:
        """Return the present positions of the rotary axes, at their least increments; raise `InputError` if one is unknown."""
        at = self.position[self.linear :]
        if any(value != value for value in at):
            raise self.error(f"{what} at unknown positions of the rotary axes", "a position of each of them before it")
        return tuple(round(value / step) * step for value, step in zip(at, self._rotary_increments, strict=True))

    def select(self, block: Block, **changes: Any) -> None:
        """Change the frame from this block on; positions in the new coordinates are unknown until the program gives them."""
        frame = replace(self.frame, **changes)
        frame = replace(frame, inclined=frame.inclined and frame.plane is not None)
        if frame == self.frame:
            return
        everything = self.tcp or (frame.offset, frame.plane) != (self.frame.offset, self.frame.plane)
        self._inclined = self._inclined and frame.plane == self.frame.plane
        if everything:
            self.check_beside()
        self.frame = frame
        self.frames.append(FrameChange(self._line, frame))
        along = (self.linear - 1,)
        words = along if frame.plane else self.words_of(along)
        self.mark_unknown(block, range(len(self.names)) if everything else words, moved=None)

    def reframe(self, block: Block, *, carried: bool, **changes: Any) -> None:
        """Change the frame by known values from this block on.

        ``carried``: whether all controls read an incremental word after it from where the axis stands; else the positions of axes whose
        words have changed are unknown until the program gives them.
        """
        frame = replace(self.frame, **changes)
        if frame == self.frame:
            return
        self._check_tcp(self.tcp, frame)
        self.check_beside()
        before, self.frame = self.frame, frame
        self.frames.append(FrameChange(self._line, frame))
        words = before.converted(self.position, frame)
        if carried:
            self.position = words
            block.reframed = (before if block.reframed is None else block.reframed[0]), frame
            return
        trials = [[float(i == j) for i in range(len(words))] for j in range(-1, self.linear)]
        changed = [i for trial in trials for i, word in enumerate(before.converted(trial, frame)) if word != trial[i]]
        self.mark_unknown(block, sorted({*changed}), moved=None)

    def check_beside(self) -> None:
        """Raise `InputError` under cutter radius compensation: the path into other coordinates is unknown."""
        if self.beside:
            ends = "R0" if self.heidenhain else "G40"
            raise self.error("other coordinates under cutter radius compensation", f"{ends} before them")

    def _check_tcp(self, tcp: bool, frame: WordFrame) -> None:
        """Raise `InputError` for a frame that is not followed under tool centre point control."""
        if tcp and (frame.stated or any(frame.shift[self.linear :])):
            what = "tool centre point control where the program shifts a rotary axis or sets a work offset"
            raise self.error(what, "shifts of the linear axes and rotations only")

    def switch(self, block: Block, on: bool, word: str) -> None:
        """Switch tool centre point control, unless it has that state already."""
        if on == self.tcp:
            return
        self._check_tcp(on, self.frame)
        if not on:
            if not self.tcp_word:
                self.note(f"{word} switches tool centre point control off")
            self.vector = None
        self.tcp = on
        if self.frame.plane is not None:
            self.frame = replace(self.frame, inclined=on)
            self.frames.append(FrameChange(self._line, self.frame))
        self.tcp_word = word if on else "off"
        block.tcp_switched = True
        self.mark_unknown(block, range(self.linear), moved=None)

    def switch_by(self, block: Block, word: str) -> None:
        """Switch tool centre point control if a word does so."""
        if word in self.tcp_on:
            self.switch(block, True, word)
        elif word in self.tcp_off:
            self.switch(block, False, word)

    # ------------------------------------------------------------------ moves

    def apply_words(self, block: Block) -> None:
        """Set the position from the axis words of a block; an increment leaves an unknown position unknown."""
        position = self.position
        for word in block.words:
            last = position[word.axis]
            position[word.axis] = last + word.value if word.incremental else word.value
            if word.incremental and last != last and word.value != 0.0:
                self.mark_unknown(block, (word.axis,), moved=True)

    def words_of(self, axes: Iterable[int]) -> set[int]:
        """Return axes of the machine and those whose words a move of one changes, because the coordinates are turned or tilted."""
        which = {*axes}
        linear = [axis for axis in which if axis < self.linear]
        if linear and self.frame.plane is not None:
            which.update(range(self.linear))
        elif self.frame.turn is not None:
            which.update(i for axis in linear for i, part in enumerate(self.frame.turn[axis]) if part)
        return which

    def unit_direction(self, what: str, components: list[float]) -> tuple[float, float, float]:
        """Return a vector at unit length; raise `InputError` if its length is zero."""
        vector, length = unit_vector((components[0], components[1], components[2]))
        if length == 0.0:
            raise self.error(f"{what} of zero length", "a direction")
        if abs(length - 1.0) > 1e-3:
            self.note(f"{what} of length {length:.6g} normalised")
        return vector

    def set_tool_vector(self, axis_bits: int, vector: tuple[float, float, float]) -> None:
        """Set the tool vector from a block that names some axes (bits); the control then determines the rotary axes.

        Turned coordinates are refused: controls differ in which vectors they turn.
        """
        if axis_bits >> self.linear:
            raise self.error("tool vector and rotary axes in one block", "only one of them")
        if self.frame.turn is not None or self.frame.plane is not None:
            raise self.error("tool vector in turned or tilted coordinates", "words of the rotary axes")
        self.vector = vector
        for i in range(self.linear, len(self.position)):
            self.position[i] = math.nan

    def valid_arc(self, found: Arc | ArcMisfit) -> Arc:
        """Return an arc; raise `InputError` if it is invalid."""
        if isinstance(found, ArcMisfit):
            raise self.error(found.what, found.expected)
        return found

    def machine_position(self, block: Block, *, elsewhere: bool = False) -> tuple[float, ...]:
        """Return the machine coordinates a block names; their place in program coordinates is unknown.

        ``elsewhere``: whether they count from a point of the machine's builder, which is not known.
        """
        unknown = {word.axis for word in block.words if word.incremental or elsewhere}
        return self.placed({word.axis: math.nan if word.axis in unknown else word.value for word in block.words}, block)

    def placed(self, values: Mapping[int, float], block: Block) -> tuple[float, ...]:
        """Return machine coordinates of some axes, NaN for the others; their place in program coordinates is unknown."""
        position = [values.get(axis, math.nan) for axis in range(len(self.names))]
        which = self.words_of(values)
        if self.tcp:
            which.update(range(self.linear))
        if any(axis >= self.linear for axis in which):
            self.vector = None
        self.mark_unknown(block, which, moved=None)
        if self.unknown:
            self._place(position)
        return tuple(position)
