"""Subprograms, loops and jumps written out as they are executed, with the origin of every line."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final, NamedTuple, final

from twin._common.errors import InputError
from twin._common.files import read_bytes, register_input
from twin.nc.blocks import Origin, Program, lines_in
from twin.nc.text import ending

DEEPEST: Final = 10
"""Most calls within calls; a subprogram that calls itself exceeds it."""
MOST_LINES: Final = 2_000_000
"""Most lines of a program with its subprograms written out."""


class Line(NamedTuple):
    """A line of a program or subprogram, with its file and number."""

    text: str
    file: str
    number: int


@final
@dataclass(frozen=True)
class Call:
    """A call found in a line.

    Attributes:
        values: what replaces its parameters: the text of each value by the parameter's name, in capitals.
        outside: whether it can only be a file of its own.
        certain: whether the line is a call even if there is no such subprogram.
        own: whether the subprogram has local parameters of its own.
    """

    name: str
    repeats: int = 1
    values: Sequence[str] = ()
    outside: bool = False
    certain: bool = True
    own: bool = True


@final
class Flow(NamedTuple):
    """A statement that decides which line is next.

    Attributes:
        kind: ``if``, ``elseif``, ``else``, ``endif``; ``while``, ``do`` (repeats from here), ``repeat`` (a number of times), ``for``;
            ``end`` of a loop, ``until`` and ``again`` (ends with a condition to leave it or to repeat it); ``goto``, ``case``, ``part``
            (repeats the lines from a label ``name`` to another, ``condition``), ``break``, ``continue``, ``return``; ``then`` (a
            statement with a condition); ``label``: nothing but the name of a line.
        name: what joins the statements of a loop, where they have names; the label of a jump.
        text: condition, number or range; of ``then``, the statement.
        condition: of a jump or ``then``; empty for none.
        towards: 1: the label is in a later line, −1: in one before; 0: in either.
    """

    kind: str
    name: str = ""
    text: str = ""
    condition: str = ""
    towards: int = 0


OPENING: Final = frozenset({"if", "while", "do", "repeat", "for"})
END_LABEL: Final = "ENDLABEL"
"""Label at the end of a part that is repeated."""
RETURN: Final = "\0return"
"""A line in place of a statement that returns from a subprogram."""
_LOOPS: Final = OPENING - {"if"}
_CLOSING: Final = frozenset({"endif", "end", "until", "again"})
Scope = dict[str, str]
"""Text in place of each local parameter; empty if its value is unknown."""


@final
class FlowStructure:
    """The loops and branches of some lines.

    Attributes:
        last: for each first statement of a loop or branch, the index of its last one.
        first: the reverse.
        branches: for each branch, the indices of its statements.
        within: for each ``break`` and ``continue``, the index of the loop's first statement.
    """

    def __init__(self, flows: Mapping[int, Flow], error: Callable[[str, str, int], InputError]) -> None:
        self.last: dict[int, int] = {}
        self.first: dict[int, int] = {}
        self.branches: dict[int, list[int]] = {}
        self.within: dict[int, int] = {}
        opened: list[int] = []
        for i, flow in flows.items():
            ends_do = bool(opened and flow.name) and flows[opened[-1]][:2] == ("do", flow.name)
            closes = flow.kind in _CLOSING or (flow.kind == "while" and ends_do)
            if flow.kind in OPENING and not closes:
                opened.append(i)
                self.branches[i] = [i]
            elif closes or flow.kind in ("elseif", "else"):
                if not opened or not _matches(flows[opened[-1]], flow):
                    raise error(f"{flow.kind} without its beginning", "loops and branches within each other", i)
                self.branches[opened[-1]].append(i)
                if closes:
                    self.first[i] = opened.pop()
                    self.last[self.first[i]] = i
            elif flow.kind in ("break", "continue"):
                loops = [one for one in opened if flows[one].kind in _LOOPS and flow.name in ("", flows[one].name)]
                if not loops:
                    raise error(f"{flow.kind} outside a loop", "it within a loop", i)
                self.within[i] = loops[-1]
        if opened:
            raise error("loop or branch without its end", "its end in the same program", opened[-1])
        self.chain = {one: chain for chain in self.branches.values() for one in chain}


def _matches(begin: Flow, end: Flow) -> bool:
    """Return whether a statement can end or divide a loop or branch."""
    branch = end.kind in ("elseif", "else", "endif")
    same = begin.kind == "for" or begin.name == end.name
    return same and (begin.kind == "if") == branch and (end.kind not in ("until", "again") or begin.kind == "do")


class Inliner(ABC):
    """Writes out the subprograms, loops and jumps of one language, as they are executed.

    ``folders``: where subprograms may be, in the order of search; ``values``: of parameters at the line that is executed, by name.
    """

    def __init__(self, program: Program, folders: Sequence[Path]) -> None:
        self.program = program
        self.folders = tuple(folders)
        self.values: dict[str, float] = {}
        self._count = 0
        self._found = False
        self._files: dict[Path, list[Line]] = {}
        self._called: list[str] = []

    @cached_property
    def lines(self) -> list[Line]:
        """The lines of the program."""
        return [Line(text, self.program.source, i) for i, text in enumerate(self.program.texts, 1)]

    @abstractmethod
    def likely(self, text: str) -> bool:
        """Return whether a line may be a call, loop or jump; quick, True for each of these and few other lines."""

    @abstractmethod
    def likely_within(self, text: str) -> bool:
        """Return whether a line of a text may be one; quicker than line by line, True if `likely` is for one of them."""

    @abstractmethod
    def call(self, line: Line) -> Call | None:
        """Return the call in a line, None if it has none; raise `InputError` for one that cannot be written out."""

    @abstractmethod
    def flow(self, line: Line) -> Flow | None:
        """Return the statement in a line that decides which line is next, or None; raise `InputError` if it cannot be followed."""

    @abstractmethod
    def labels(self, line: Line) -> Sequence[str]:
        """Return the names of a line as jumps have them."""

    @abstractmethod
    def assign(self, line: Line) -> None:
        """Take over the values that a line gives to parameters."""

    @abstractmethod
    def value(self, text: str) -> float:
        """Return the value of an expression or a condition; NaN if it is unknown."""

    @abstractmethod
    def plain(self, line: Line, scope: Scope) -> Line:
        """Return a line to write: without its label, with the values of local parameters; one that only assigns these is a comment."""

    def calls(self, line: Line) -> bool:
        """Return whether a line calls a subprogram or decides which line is next, also where that cannot be written out."""
        try:
            call = self.call(line)
            called = call is not None and (call.certain or self.body(call, line) is not None)
            return called or self.flow(line) is not None
        except InputError:
            return True

    @abstractmethod
    def body(self, call: Call, line: Line) -> list[Line] | None:
        """Return the lines of a subprogram with the values of its parameters; None if there is no such subprogram."""

    def check_missing(self, call: Call, line: Line) -> None:
        """Raise `InputError` for a subprogram that must be in its file; the interpreter decides about others that are not given."""
        return

    def scope(self, call: Call, line: Line) -> Scope:
        """Return the local parameters of a subprogram whose values are not in the lines of `body`; at the call."""
        return {}

    def beyond(self, name: str, line: Line) -> list[Line] | None:
        """Return the lines that a jump to a label out of a subprogram executes, up to the return from it; None if there are none."""
        return None

    @abstractmethod
    def main(self) -> list[Line]:
        """Return the lines that the control executes, in order, where calls stand for their subprograms."""

    def ends(self, line: Line) -> bool:
        """Return whether a line ends the program where it is executed, whatever stands behind it."""
        return False

    @abstractmethod
    def comment(self, text: str) -> str:
        """Return a text as a comment."""

    def expanded(self) -> Program:
        """Return the program with calls, loops and jumps written out; the program itself if it has none.

        It raises `InputError` for one that cannot be written out, with its file and line.
        """
        if not self.likely_within(self.program.text):
            return self.program
        likely = [self.lines[i] for i, text in enumerate(self.program.texts) if self.likely(text)]
        if not any(self.call(line) or self.flow(line) for line in likely):
            return self.program
        lines: list[tuple[str, Origin]] = []
        for line, main in self._run(self.main(), 0, {}):
            lines.append((line.text, Origin(line.file, line.number, main)))
        if not self._found:
            return self.program
        origins = tuple(
            replace(origin, main=origin.line) if origin.file == self.program.source else origin for _, origin in lines
        )
        return replace(self.program, texts=tuple(text for text, _ in lines), origins=origins)

    def _run(self, lines: Sequence[Line], depth: int, scope: Scope) -> Iterator[tuple[Line, int]]:
        """Yield lines as they are executed, each with the number of the line among those given that it is from."""
        flows = {i: flow for i, line in enumerate(lines) if self.likely(line.text) and (flow := self.flow(line))}
        run = FlowRun(self, lines, flows, scope) if flows else None
        self._found |= run is not None
        at = 0
        while at < len(lines):
            line, here = lines[at], at
            self._step(line)
            at += 1
            if run is None or here not in flows:
                yield from ((one, line.number) for one in self._written(self.plain(line, scope), depth, scope))
                if run is not None and not depth and self.ends(line):
                    yield from ((last, last.number) for last in lines[-1:] if last.text.strip() == "%")
                    return
                continue
            at = run.after(here)
            for one in run.added:
                if isinstance(one, Line):
                    self.assign(one)
                    yield one, line.number
                else:
                    yield from ((again, line.number) for again, _ in self._run(one, depth, scope))
            run.added.clear()

    def _step(self, line: Line) -> None:
        self._count += 1
        if self._count > MOST_LINES:
            expected = f"at most {MOST_LINES:,} lines as executed: does a loop never end?"
            raise refused("the program is too long with its subprograms and loops", expected, line)

    def _written(self, line: Line, depth: int, scope: Scope) -> Iterator[Line]:
        """Yield a line, or the lines of the subprogram that it calls."""
        call = self.call(line)
        body = None if call is None else self.body(call, line)
        if call is None or body is None:
            if call is not None and call.certain:
                self.check_missing(call, line)
            self.assign(line)
            yield line
            return
        if depth >= DEEPEST:
            raise refused("subprograms call each other too deeply", f"at most {DEEPEST} levels", line)
        self._found = True
        yield line._replace(text=self.comment(line.text))
        own = self.scope(call, line) if call.own else None
        self._called.append(call.name)
        for _ in range(call.repeats if body else 0):
            for one, _ in self._run(body, depth + 1, scope if own is None else dict(own)):
                yield one
        self._called.pop()

    def known(self, text: str, line: Line) -> float:
        """Return the value of an expression or a condition; raise `InputError` if it is unknown."""
        value = self.value(text)
        if value != value:
            expected = "numbers, or parameters set to numbers before; and no numbers compared that are almost equal"
            raise refused(f"the value of {text.strip()} is unknown", expected, line)
        return value

    def read_file(self, path: Path) -> list[Line]:
        """Return the lines of another file, which is read once."""
        if path not in self._files:
            register_input(path)
            self._files[path] = [Line(text, str(path), i) for i, text in enumerate(lines_in(read_bytes(path)), 1)]
        return self._files[path]

    def file_named(self, *names: str) -> Path | None:
        """Return the file of the first folder that has one of these names, whatever its capitals; None if there is none."""
        for folder in self.folders:
            try:
                files = {path.name.upper(): path for path in sorted(folder.iterdir()) if path.is_file()}
            except OSError as error:
                expected = "a folder with subprograms"
                what, shown = "cannot be searched", error.strerror
                raise InputError(what, expected=expected, file=folder, value=shown, setting="subprograms") from None
            found = next((files[name.upper()] for name in names if name.upper() in files), None)
            if found is not None:
                return found
        return None


@final
class FlowRun:
    """The statements of some lines that decide which line is next, while they are executed.

    ``added``: what `after` has to write before the next line: a line, or lines to be executed.
    """

    def __init__(self, inliner: Inliner, lines: Sequence[Line], flows: Mapping[int, Flow], scope: Scope) -> None:
        self.added: list[Line | Sequence[Line]] = []
        self._inliner, self._lines, self._flows, self._scope = inliner, lines, flows, scope
        self._structure = FlowStructure(flows, lambda what, expected, at: refused(what, expected, lines[at]))
        self._left: dict[int, int] = {}
        self._counts: dict[int, int] = {}
        self._states: dict[int, tuple[dict[str, float], dict[str, str], dict[int, int], dict[int, int]]] = {}
        """Values and counts at the last way back from each statement."""
        self._labels: dict[str, list[int]] = {}
        for i, line in enumerate(lines):
            for name in inliner.labels(line):
                self._labels.setdefault(name, []).append(i)

    def after(self, at: int) -> int:
        """Return the index of the line to execute after a statement, and record what it writes in `added`."""
        self.added.append(self._lines[at]._replace(text=self._inliner.comment(self._lines[at].text)))
        following = self._next(at)
        if following <= at:
            self._check_progress(at)
        return following

    def _check_progress(self, at: int) -> None:
        """Raise `InputError` for a way back on which nothing has changed since the last time: it would be taken for ever."""
        state = (dict(self._inliner.values), dict(self._scope), dict(self._left), dict(self._counts))
        if self._states.get(at) == state:
            expected = "parameters of its condition that the program changes; what the control changes, by probing, is not known"
            raise refused("the loop never ends", expected, self._lines[at])
        self._states[at] = state

    def _next(self, at: int) -> int:
        """Return the index of the line to execute after a statement."""
        flow = self._flows[at]
        first = self._structure.first.get(at)
        if first is not None:
            return self._end(at, first)
        if flow.kind in OPENING:
            return self._begin(at, flow)
        handler = _AFTER.get(flow.kind)
        return at + 1 if handler is None else handler(self, at, flow)

    def _begin(self, at: int, flow: Flow) -> int:
        """Return the line after the first statement of a loop or branch."""
        behind = self._structure.last[at] + 1
        if flow.kind == "if":
            return self._branch(at)
        if flow.kind == "while":
            return at + 1 if self._true(flow.text, at) else behind
        if flow.kind == "repeat":
            self._left[at] = int(self._number(flow.text, at))
            return at + 1 if self._left[at] > 0 else behind
        if flow.kind == "for":
            return self._count(at, flow)
        return at + 1

    def _branch(self, at: int) -> int:
        """Return the line after the first statement of a branch, from one of them on, whose condition is true."""
        chain = self._structure.chain[at]
        for one in chain[chain.index(at) :]:
            flow = self._flows[one]
            if flow.kind not in ("if", "elseif") or self._true(flow.text, one):
                return one + 1
        return chain[-1] + 1

    def _end(self, at: int, first: int) -> int:
        """Return the line after the last statement of a loop or branch; ``first``: its first statement."""
        begin, flow = self._flows[first], self._flows[at]
        if begin.kind == "if":
            return at + 1
        if begin.kind in ("repeat", "for"):
            self._left[first] = self._left.get(first, 0) - 1
            if begin.kind == "repeat":
                return first + 1 if self._left[first] > 0 else at + 1
            return self._again(first, at + 1)
        if begin.kind == "while":
            return first
        leaves = {"until": True, "again": False, "while": False}.get(flow.kind)
        return first + 1 if leaves is None or self._true(flow.text, at) is not leaves else at + 1

    def _count(self, at: int, flow: Flow) -> int:
        """Return the line after ``FOR``; its variable is a local parameter until the loop ends."""
        begin, end = (self._number(text, at) for text in flow.text.split("\0"))
        if begin != int(begin) or end != int(end):
            raise refused("a loop that does not count whole numbers", "whole numbers", self._lines[at])
        self._left[at] = int(end) - int(begin) + 1
        self._counts[at] = int(begin) - 1
        return self._again(at, self._structure.last[at] + 1)

    def _again(self, first: int, behind: int) -> int:
        """Return the line after the next count of a loop, or the one behind the loop."""
        name = self._flows[first].name
        more = self._left[first] > 0
        # Controls differ in the value after the loop.
        self._counts[first] += 1
        self._scope[name] = f"({self._counts[first]})" if more else ""
        self._inliner.values[name] = float(self._counts[first]) if more else math.nan
        return first + 1 if more else behind

    def _then(self, at: int, flow: Flow) -> int:
        if self._true(flow.condition, at):
            line = self._lines[at]
            text = with_ending(flow.text, line.text)
            self.added.append([line._replace(text=text)])
        return at + 1

    def _goto(self, at: int, flow: Flow) -> int:
        if flow.condition and not self._true(flow.condition, at):
            return at + 1
        beyond = None if flow.name in self._labels else self._inliner.beyond(flow.name, self._lines[at])
        if beyond is not None:
            self.added.append(beyond)
            return len(self._lines)
        return self._target(flow.name, at, flow.towards)

    def _case(self, at: int, flow: Flow) -> int:
        """Return the line after ``CASE``: pairs of value and jump in ``text``, an empty value for the default."""
        value = self._number(flow.condition, at)
        for when, name, towards in (part.split("\1") for part in flow.text.split("\0")):
            if not when or self._number(when, at) == value:
                return self._target(name, at, int(towards))
        return at + 1

    def _part(self, at: int, flow: Flow) -> int:
        first = self._target(flow.name, at, flow.towards)
        if flow.condition:
            last = first if flow.condition == flow.name else self._target(flow.condition, first, 1)
        else:
            ends = [i for i in self._labels.get(END_LABEL, []) if i > first and not first < at < i]
            if not ends and first > at:
                raise refused("repetition of a part without its end", "a second label, or ENDLABEL", self._lines[at])
            last = ends[0] if ends else at - 1
        for _ in range(int(self._number(flow.text, at))):
            self.added.append(self._lines[first : last + 1])
        return at + 1

    def _target(self, name: str, at: int, towards: int) -> int:
        """Return the index of the line with a label."""
        places = [i for i in self._labels.get(name, []) if not towards or (i - at) * towards > 0]
        places = places if not towards else places[:1] if towards > 0 else places[-1:]
        if len(places) != 1:
            what = f"{'several' if places else 'no'} labels {name}" if places else f"no label {name}"
            raise refused(what, "one such label in this program", self._lines[at])
        return places[0]

    def _true(self, text: str, at: int) -> bool:
        return self._number(text, at) != 0.0

    def _number(self, text: str, at: int) -> float:
        line = self._inliner.plain(self._lines[at]._replace(text=text), self._scope)
        return self._inliner.known(line.text, self._lines[at])


_AFTER: Final[Mapping[str, Callable[[FlowRun, int, Flow], int]]] = {
    **dict.fromkeys(("elseif", "else"), lambda run, at, flow: run._structure.chain[at][-1] + 1),
    "then": FlowRun._then,
    "goto": FlowRun._goto,
    "case": FlowRun._case,
    "part": FlowRun._part,
    "break": lambda run, at, flow: run._structure.last[run._structure.within[at]] + 1,
    "continue": lambda run, at, flow: run._structure.last[run._structure.within[at]],
    "return": lambda run, at, flow: len(run._lines),
}


@contextmanager
def errors_in_files(program: Program) -> Iterator[None]:
    """Let an `InputError` at a line of a program name the file and line that this line is from."""
    try:
        yield
    except InputError as error:
        if not program.origins or error.file != program.source or error.line is None:
            raise
        origin = program.origins[error.line - 1]
        raise InputError(
            error.what,
            expected=error.expected,
            file=origin.file,
            line=origin.line,
            value=error.value,
            nearest=error.nearest,
            setting=error.setting,
        ) from None


def refused(what: str, expected: str, line: Line) -> InputError:
    """Return the error at a line."""
    return InputError(what, expected=expected, file=line.file, line=line.number, value=line.text.strip())


def with_ending(text: str, like: str) -> str:
    """Return a text with the line ending of a line."""
    return text.rstrip("\r\n") + (ending(like) or "\n")
