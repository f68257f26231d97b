"""Subprograms of Heidenhain programs: ``CALL LBL``, repetition of a part of the program, and ``CALL PGM``.

Source: Heidenhain TNC 640, user's manual Klartext programming, "Subprograms and program-section repeats".

"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, final

import numpy as np

from twin.nc.arithmetic import evaluate, key_of
from twin.nc.blocks import Program, line_ends
from twin.nc.dialect import as_comment
from twin.nc.heidenhain.vocabulary import ASSIGNED, HEAD, SKIPPED_END
from twin.nc.inline import MOST_LINES, Call, Flow, Inliner, Line, Scope, refused, with_ending
from twin.nc.lines import LineCode, Scan

_FLAGS: Final = re.ASCII | re.IGNORECASE
_NAME: Final = r"(?:\"([^\"]*)\"|(\d+))"
_CALL: Final = re.compile(rf"CALL[ \t]+LBL[ \t]+{_NAME}(?:[ \t]+REP[ \t]*(\d+|Q[LR]?\d+)?(?:/\d+)?)?[ \t]*$", _FLAGS)
_PROGRAM: Final = re.compile(r"CALL[ \t]+PGM[ \t]+\"?([^\"]*?)\"?[ \t]*$", _FLAGS)
_ANY_CALL: Final = re.compile(r"CALL[ \t]+(?:LBL|PGM)\b", _FLAGS)
_JUMP: Final = re.compile(
    rf"(?:FN[ \t]*(?:9|1[012])[ \t]*:[ \t]*)?IF[ \t]+(\S+)[ \t]+(EQU|NE|GT|LT)[ \t]+(\S+)[ \t]+GOTO[ \t]+LBL[ \t]+{_NAME}[ \t]*",
    _FLAGS,
)
_LABEL: Final = re.compile(rf"LBL[ \t]+{_NAME}[ \t]*$", _FLAGS)
_END: Final = re.compile(r"(?:STOP[ \t]+)?M0*(?:2|30)(?!\d)|.*[ \t]M0*(?:2|30)(?!\d)|END[ \t]+PGM\b", _FLAGS)
_UNIT: Final = re.compile(r"^BEGIN[ \t]+PGM\b.*[ \t](MM|IN)(?:CH)?$", _FLAGS)
_FRAME: Final = re.compile(r"(?:BEGIN|END)[ \t]+PGM\b|BLK[ \t]+FORM\b", _FLAGS)


@final
class HeidenhainInliner(Inliner):
    """Writes out the subprograms of Heidenhain programs."""

    def __init__(self, program: Program, folders: Sequence[Path]) -> None:
        super().__init__(program, folders)
        self._labels: dict[str, Mapping[str, list[int]]] = {}

    def likely(self, text: str) -> bool:
        """See `Inliner.likely`."""
        upper = text.upper()
        return "CALL" in upper or "IF" in upper

    likely_within = likely

    def call(self, line: Line) -> Call | None:
        """See `Inliner.call`."""
        if not self.likely(line.text):
            return None
        bare = _bare(line)
        if not _ANY_CALL.match(bare):
            return None
        label, program = _CALL.match(bare), _PROGRAM.match(bare)
        if label is not None and label.group(3) is None and " REP" not in bare.upper():
            return Call(_name(label), own=False)
        if label is not None and label.group(3):
            # The part since the label has run once when the control comes to the call.
            return Call(_name(label), self._times(label.group(3), line), values=("repeats",), own=False)
        if program is not None:
            return Call(program.group(1), outside=True, own=False)
        raise refused("call", "CALL LBL with a number or name, REP with a number, or CALL PGM with a file", line)

    def _times(self, text: str, line: Line) -> int:
        """Return a number of repetitions; that of a Q parameter is 1 before the program runs."""
        if text.isdigit():
            return int(text)
        value = self.known(text, line) if self._count else 1.0
        if value != int(value) or not 0.0 <= value <= MOST_LINES:
            raise refused("repetition of a part", "a whole number of times", line)
        return int(value)

    def flow(self, line: Line) -> Flow | None:
        """See `Inliner.flow`."""
        match = _JUMP.fullmatch(_bare(line))
        if match is None:
            return None
        first, operator, second, name, number = match.groups()
        return Flow("goto", name if name is not None else str(int(number)), "", f"{first} {operator} {second}")

    def labels(self, line: Line) -> list[str]:
        """See `Inliner.labels`."""
        name = _label(line)
        return [name] if name else []

    def value(self, text: str) -> float:
        """See `Inliner.value`."""
        return evaluate(text, self.values, heidenhain=True)

    def assign(self, line: Line) -> None:
        """See `Inliner.assign`."""
        for name, text in ASSIGNED.findall(_bare(line)) if "=" in line.text else ():
            self.values[key_of(name)] = self.value(text.strip())

    def plain(self, line: Line, scope: Scope) -> Line:
        """See `Inliner.plain`."""
        return _as_remark(line) if "LBL" in line.text.upper() and _LABEL.match(_bare(line)) else line

    def main(self) -> list[Line]:
        """See `Inliner.main`: up to the end of the program, then ``END PGM``."""
        return list(self._until_end(self.lines))

    def _until_end(self, lines: Sequence[Line]) -> Iterator[Line]:
        for line in lines:
            yield line
            if _END.match(_bare(line)) or SKIPPED_END.fullmatch(line.text.strip()):
                break
        last = [line for line in lines if re.match(r"END[ \t]+PGM\b", _bare(line), _FLAGS)]
        if last and last[-1] is not line:
            yield last[-1]

    def body(self, call: Call, line: Line) -> list[Line] | None:
        """See `Inliner.body`."""
        if call.outside:
            path = self._path(call.name)
            return None if path is None else self._whole(path)
        lines = self.lines if line.file == self.program.source else self.read_file(Path(line.file))
        labels = self._labels_of(line.file, lines)
        begin = next(iter(labels.get(call.name, ())), None)
        if begin is None:
            return None
        if not call.repeats:
            return []
        if call.values:
            if line.number <= begin + 1:
                raise refused("repetition of a part that comes later", "CALL LBL with REP behind its label", line)
            part = lines[begin + 1 : line.number - 1]
            if any(_label(one) == "0" for one in part):
                raise refused("repetition across the end of a subprogram", "a part without LBL 0", line)
        else:
            ends = labels.get("0", [])
            behind = bisect_right(ends, begin)
            if behind == len(ends):
                raise refused(f"subprogram {call.name} without an end", "LBL 0", line)
            part = lines[begin + 1 : ends[behind]]
        return list(part)

    def check_missing(self, call: Call, line: Line) -> None:
        """See `Inliner.check_missing`: a label."""
        if not call.outside:
            raise refused(f"no subprogram {call.name}", "its label in this file", line)

    def beyond(self, name: str, line: Line) -> list[Line] | None:
        """See `Inliner.beyond`: a label behind the subprogram; its ``LBL 0`` returns from it."""
        if not self._called:
            return None
        lines = self.lines if line.file == self.program.source else self.read_file(Path(line.file))
        labels = self._labels_of(line.file, lines)
        begin = next((at for at in labels.get(name, ()) if at >= line.number), None)
        end = None if begin is None else next((at for at in labels.get("0", ()) if at > begin), None)
        return None if begin is None or end is None else lines[begin + 1 : end]

    def _labels_of(self, file: str, lines: Sequence[Line]) -> Mapping[str, list[int]]:
        """Return the indices of the lines of a file with a label, in order, by its name; looked for once."""
        if file not in self._labels:
            found: dict[str, list[int]] = {}
            for i, line in enumerate(lines):
                if name := _label(line):
                    found.setdefault(name, []).append(i)
            self._labels[file] = found
        return self._labels[file]

    def _whole(self, path: Path) -> list[Line]:
        """Return the blocks of another program; raise `InputError` if it ends the whole machining, or has other units."""
        lines = self.read_file(path)
        begin = next((one for one in self.lines if _UNIT.search(_bare(one))), None)
        for line in lines:
            unit = _UNIT.search(_bare(line))
            if unit is not None and begin is not None and unit[1].upper() != _UNIT.search(_bare(begin))[1].upper():  # type: ignore[index]
                raise refused("program in other units than the one that calls it", "the same units", line)
            if _END.match(_bare(line)) and not _FRAME.match(_bare(line)):
                raise refused("called program with M2 or M30", "a program that ends with END PGM", line)
        return [line for line in lines if not _FRAME.match(_bare(line))]

    def _path(self, name: str) -> Path | None:
        short = re.split(r"[\\/:]", name)[-1]
        return self.file_named(short, f"{short}.h")

    def comment(self, text: str) -> str:
        """See `Inliner.comment`."""
        return _as_remark(Line(text, "", 0)).text


def _bare(line: Line) -> str:
    head = HEAD.match(line.text)
    return line.text[0 if head is None else head.end() :].split(";")[0].strip()


def _name(found: re.Match[str]) -> str:
    return found.group(1) if found.group(1) is not None else str(int(found.group(2)))


def _label(line: Line) -> str:
    """Return the name of the label in a line, empty if it has none."""
    match = _LABEL.match(_bare(line))
    return "" if match is None else _name(match)


def _as_remark(line: Line) -> Line:
    """Return a line as a comment with its block number."""
    head = HEAD.match(line.text)
    at = 0 if head is None else head.end()
    body = as_comment(line.text[at:], "~")
    return line._replace(text=with_ending(f"{line.text[:at]}; {body}", line.text))


# --- Simple lines of plain language found all at once, through an image of the text that has the form of ISO lines
# They are a subset of those of `twin.nc.heidenhain.vocabulary.simple_pattern`: a block number, ``L`` in capitals, signed axis words in
# the usual order, each after a blank, ``R0``, and a feed or ``FMAX``. The image has the same length, so that the places of its words
# are those of the text: ``12 L X+1,5 R0 F500`` becomes ``··G1·X+1.5····F500`` (· is a blank).

_IMAGE: Final = bytes(
    ord(".") if c == ord(",") else ord("?") if chr(c).islower() or c in b"GN" else c for c in range(256)
)
"""Characters of the image: a point for a decimal comma; for letters that only ISO lines may have, a character that they cannot have."""
_BLANK, _DIGIT, _OTHER, _KEYWORD, _COMMENT = range(5)
_KINDS: Final = bytes(
    _BLANK
    if c in b" \t"
    else _DIGIT
    if c in b"0123456789"
    else _KEYWORD
    if c == ord("L")
    else _COMMENT
    if c in b";*%"
    else _OTHER
    for c in range(256)
)
LONGEST_HEAD: Final = 32
"""Most characters before the keyword of a simple line: blanks and the block number."""
_RAPID: Final = re.compile(rb"[ \t]FMAX(?=[ \t\r\n])")


def scan(data: bytes, names: tuple[str, ...], code: LineCode) -> Scan:
    """Find and read the simple lines of whole lines of a program, of motion code 0 with ``FMAX`` and 1 without."""
    image = _with_iso_heads(data)
    if b"R0" in image:
        for end in (b" ", b"\r", b"\n"):
            image = image.replace(b" R0" + end, b"   " + end)
    rapids: list[int] = []
    if b"FMAX" in image:
        rapids = [match.start() for match in _RAPID.finditer(image)]
        image = _RAPID.sub(b"     ", image)
    scan = code.scan(image, names)
    text, words = np.frombuffer(data, dtype=np.uint8), scan.words
    before = text[words.start - 2]
    simple = scan.simple & (scan.code == 1)
    simple[words.line[(words.sign == 0) | ~((before == ord(" ")) | (before == ord("\t")))]] = False
    motion = np.where(simple, scan.code, np.int8(-1))
    with_fmax = np.searchsorted(scan.end, np.array(rapids, dtype=int), side="right")
    motion[with_fmax[simple[with_fmax]]] = 0
    return replace(scan, data=data, text=text, simple=simple, code=motion)


def _with_iso_heads(data: bytes) -> bytes:
    """Return the image of a text in which the head of an L block ends in ``G1``, and that of a comment in ``;``."""
    image = np.frombuffer(bytearray(data.translate(_IMAGE)), dtype=np.uint8)
    text, kind = (np.frombuffer(one, dtype=np.uint8) for one in (data, data.translate(_KINDS)))
    starts = np.concatenate([[0], line_ends(text, data) + 1])
    at = np.flatnonzero(kind >= _KEYWORD)
    start = starts[np.searchsorted(starts, at, side="right") - 1]
    good = at - start <= LONGEST_HEAD
    good &= (kind[at] == _COMMENT) | (kind.take(at + 1, mode="clip") == _BLANK)
    at, start = at[good], start[good]
    numbers, within = np.zeros(len(at), dtype=int), np.zeros(len(at), dtype=bool)
    good = np.ones(len(at), dtype=bool)
    longest = int((at - start).max(initial=0))
    for i in range(longest):
        here = np.where(start + i < at, kind.take(start + i, mode="clip"), _BLANK)
        good &= here <= _DIGIT
        numbers += (here == _DIGIT) & ~within
        within = here == _DIGIT
    good &= numbers <= 1
    at, start = at[good], start[good]
    for i in range(longest):
        image[start[start + i < at] + i] = ord(" ")
    moves = at[kind[at] == _KEYWORD]
    image[at], image[moves], image[moves + 1] = ord(";"), ord("G"), ord("1")
    return image.tobytes()
