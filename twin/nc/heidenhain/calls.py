"""Subprograms of Heidenhain programs: ``CALL LBL``, repetition of a part of the program, and ``CALL PGM``.

Source: Heidenhain TNC 640, user's manual Klartext programming, "Subprograms and program-section repeats".
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, final

from twin.nc.blocks import Program
from twin.nc.dialect import as_comment
from twin.nc.heidenhain.vocabulary import HEAD
from twin.nc.inline import Call, Inliner, Line, refused, with_ending

_FLAGS: Final = re.ASCII | re.IGNORECASE
_NAME: Final = r"(?:\"([^\"]*)\"|(\d+))"
_CALL: Final = re.compile(rf"CALL[ \t]+LBL[ \t]+{_NAME}(?:[ \t]+REP[ \t]*(\d+)?(?:/\d+)?)?[ \t]*$", _FLAGS)
_PROGRAM: Final = re.compile(r"CALL[ \t]+PGM[ \t]+\"?([^\"]*?)\"?[ \t]*$", _FLAGS)
_ANY_CALL: Final = re.compile(r"CALL[ \t]+(?:LBL|PGM)\b", _FLAGS)
_LABEL: Final = re.compile(rf"LBL[ \t]+{_NAME}[ \t]*$", _FLAGS)
_END: Final = re.compile(r"(?:STOP[ \t]+)?M0*(?:2|30)(?!\d)|.*[ \t]M0*(?:2|30)(?!\d)|END[ \t]+PGM\b", _FLAGS)
_UNIT: Final = re.compile(r"^BEGIN[ \t]+PGM\b.*[ \t](MM|INCH)$", _FLAGS)
_FRAME: Final = re.compile(r"(?:BEGIN|END)[ \t]+PGM\b|BLK[ \t]+FORM\b", _FLAGS)


@final
class HeidenhainInliner(Inliner):
    """Writes out the subprograms of Heidenhain programs."""

    def __init__(self, program: Program, folder: Path | None) -> None:
        super().__init__(program, folder)
        self._labels: dict[str, Mapping[str, list[int]]] = {}

    def likely(self, text: str) -> bool:
        """See `Inliner.likely`."""
        return "CALL" in text.upper()

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
            return Call(_name(label))
        if label is not None and label.group(3):
            # The part since the label has run once when the control comes to the call.
            return Call(_name(label), int(label.group(3)), values=("repeats",))
        if program is not None:
            return Call(program.group(1), outside=True)
        raise refused("call", "CALL LBL with a number or name, REP with a number, or CALL PGM with a file", line)

    def main(self) -> list[Line]:
        """See `Inliner.main`: up to the end of the program, without its labels, then ``END PGM``."""
        return list(self._until_end(self.lines))

    def _until_end(self, lines: Sequence[Line]) -> Iterator[Line]:
        for line in lines:
            bare = _bare(line)
            yield _as_remark(line) if _LABEL.match(bare) else line
            if _END.match(bare):
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
        return [_as_remark(one) if _label(one) else one for one in part]

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
        """Return the blocks of another program.

        Raises:
            InputError: it ends the whole machining, or has other units.
        """
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
    found = _LABEL.match(_bare(line))
    return "" if found is None else _name(found)


def _as_remark(line: Line) -> Line:
    """Return a line as a comment with its block number."""
    head = HEAD.match(line.text)
    at = 0 if head is None else head.end()
    body = as_comment(line.text[at:], "~")
    return line._replace(text=with_ending(f"{line.text[:at]}; {body}", line.text))
