"""Subprograms of ISO programs: Fanuc ``M98`` and ``G65``, LinuxCNC ``o100 call``, SINUMERIK ``NAME(..)``, ``L100`` and ``CALL``.

Sources: Fanuc Series 30i operator's manual ("Subprogram", "Custom macro"), LinuxCNC user manual ("O Codes"), SINUMERIK 840D sl
Programming Manual Job Planning ("Subprograms", "EXTCALL").
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, final

import numpy as np

from twin.nc.arithmetic import key_of
from twin.nc.blocks import Program
from twin.nc.dialect import as_comment
from twin.nc.inline import DEEPEST, Call, Inliner, Line, refused, with_ending
from twin.nc.iso import vocabulary
from twin.nc.iso.cycles import SINUMERIK

_FLAGS: Final = re.ASCII | re.IGNORECASE
_NUMBER: Final = re.compile(r"[ \t]*(?:N\d+[ \t]*)?", _FLAGS)
_NOTES: Final = re.compile(rf"{vocabulary.NOTE}|;.*", re.DOTALL)
_FANUC: Final = re.compile(r"M[ \t]*1?98(?!\d)", _FLAGS)
_WORD: Final = re.compile(r"([A-Z])[ \t]*([+-]?[\d.]+|[+-]?#\d+|[+-]?\[[^\[\]]*\])", _FLAGS)
_MACRO: Final = re.compile(r"G[ \t]*65(?![\d.])", _FLAGS)
_END: Final = re.compile(r"(?<![A-Z\d])M[ \t]*0*(?:2|30)(?!\d)", _FLAGS)
_RETURN: Final = re.compile(r"(?<!\w)(?:M[ \t]*0*(?:99|17|30|2)(?![\d=])|RET(?!\w))", _FLAGS)
_CALL_AT_BEGIN: Final = r"[ \t]*(?:[Nn]\d+[ \t]*)?(?:[Oo][ \t]*[\d<]|[Ll][ \t]*\d|[A-Za-z_][A-Za-z_])"
_LIKELY: Final = re.compile(_CALL_AT_BEGIN, re.ASCII)
_INSIDE: Final = re.compile(r"M[ \t]*1?98|G[ \t]*65", _FLAGS)
_LIKELY_WITHIN: Final = re.compile(rf"[\r\n]{_CALL_AT_BEGIN}", re.ASCII)
"""The first of these two at the begin of a line; quick, because letters of both cases are written out."""
_LOCALS: Final = 33
"""Number of local variables of a macro."""
_O_WORD: Final = re.compile(r"O[ \t]*(\d+|<[^>]*>)[ \t]*(SUB|ENDSUB|RETURN|CALL)(?!\w)[ \t]*(.*)", _FLAGS | re.DOTALL)
_O_NUMBER: Final = re.compile(r"[O:][ \t]*(\d+)[ \t]*$", _FLAGS)
_NAMED: Final = re.compile(
    r"(?:(?:EXT)?CALL[ \t]*\(?[ \t]*\"([^\"]+)\"[ \t]*\)?|([A-Z_]\w*)[ \t]*(\([^;]*\))?)(?:[ \t]+P[ \t]*=?[ \t]*(\d+))?[ \t]*$",
    _FLAGS,
)
_PROC: Final = re.compile(r"PROC[ \t]+(\w+)[ \t]*(?:\(([^)]*)\))?(.*)", _FLAGS | re.DOTALL)
_ARGUMENTS: Final = dict(
    zip(
        "ABCIJKDEFHMQRSTUVWXYZ",
        (1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 13, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26),
        strict=True,
    )
)
"""Local variable of each argument of ``G65`` (argument specification I)."""
_STATEMENTS: Final = (
    vocabulary.PASSED | vocabulary.CONTROL_FLOW | vocabulary.TRANSFORMS | vocabulary.CURVES | SINUMERIK
) - {"CALL"}
_PARAMETER: Final = re.compile(r"#\d+|#<[^>]*>")
_ASSIGNED: Final = re.compile(r"(#\d+|#<[^>]*>)[ \t]*=(?!=)")
_SUFFIXES: Final = ("", ".spf", ".mpf", ".nc", ".ngc", ".txt", ".tap", ".iso", ".cnc", ".ptp", ".eia", ".min", ".sub")


def _may_call_inside(text: str) -> bool:
    """Return whether M or G stands before 98, 198 or 65 in a text that begins with a line ending: so in all that `_INSIDE` finds."""
    characters = np.frombuffer(text.encode("latin-1"), dtype=np.uint8)
    first, second = characters[:-1], characters[1:]
    pairs = ((first == ord("9")) & (second == ord("8"))) | ((first == ord("6")) & (second == ord("5")))
    before = np.flatnonzero(pairs) - 1
    before -= characters[before] == ord("1")
    while (blank := np.isin(characters[before], np.frombuffer(b" \t", dtype=np.uint8))).any():
        before -= blank
    return bool(np.isin(characters[before], np.frombuffer(b"MmGg", dtype=np.uint8)).any())


@final
class IsoInliner(Inliner):
    """Writes out the subprograms of ISO programs."""

    def __init__(self, program: Program, folders: Sequence[Path]) -> None:
        super().__init__(program, folders)
        self._bodies: dict[tuple[str, bool], list[Line] | None] = {}

    def likely(self, text: str) -> bool:
        """See `Inliner.likely`."""
        inside = ("98" in text or "65" in text) and _INSIDE.search(text) is not None
        return inside or _LIKELY.match(text) is not None

    def likely_within(self, text: str) -> bool:
        """See `Inliner.likely_within`."""
        lines = "\n" + text
        return _LIKELY_WITHIN.search(lines) is not None or _may_call_inside(lines)

    def call(self, line: Line) -> Call | None:
        """See `Inliner.call`."""
        if not self.likely(line.text):
            return None
        text = line.text[_NUMBER.match(line.text).end() :]  # type: ignore[union-attr]  # it matches anything
        bare = _NOTES.sub("", text).strip()
        if _FANUC.search(bare):
            return self._fanuc(line, bare)
        if _MACRO.search(bare):
            return self._macro(line, bare)
        word = _O_WORD.match(bare)
        if word is not None:
            if word.group(2).upper() != "CALL":
                return None
            return Call(f"O{word.group(1)}", values=_locals(dict(enumerate(_bracketed(word.group(3), line), 1))))
        named = _NAMED.match(text.split(";")[0].strip())
        if named is None or (named.group(2) or "").upper() in _STATEMENTS:
            return None
        name = named.group(1) or named.group(2)
        values = _arguments(named.group(3))
        certain = named.group(1) is not None or re.fullmatch(r"L\d+", name, _FLAGS) is not None
        return Call(name, int(named.group(4) or 1), values, outside=True, certain=certain)

    def _fanuc(self, line: Line, bare: str) -> Call:
        words = dict(_words(bare))
        if set(words) - {"M", "P", "L"} or not words.get("P", "").isdigit() or not words.get("L", "1").isdigit():
            raise refused("subprogram call", "a block with only M98, P and L", line)
        digits, repeats = words["P"], int(words.get("L", "1"))
        if len(digits) > 4 and "L" not in words:
            digits, repeats = digits[-4:], int(digits[:-4])
        return Call(f"O{int(digits)}", repeats)

    def _macro(self, line: Line, bare: str) -> Call:
        words = _words(bare)
        values = dict(words)
        if len(values) < len(words) or not values.get("P", "").isdigit():
            raise refused("macro call", "G65 with a program number P and each argument once", line)
        unknown = set(values) - set(_ARGUMENTS) - {"G", "P", "L"}
        if unknown:
            raise refused("macro call", f"arguments other than {' '.join(sorted(unknown))}", line)
        given = {
            _ARGUMENTS[letter]: value if value.startswith("[") else f"[{value}]"
            for letter, value in values.items()
            if letter in _ARGUMENTS
        }
        return Call(f"O{int(values['P'])}", int(values.get("L", "1")), _locals(given))

    def main(self) -> list[Line]:
        """See `Inliner.main`: without the definitions of subprograms, up to the end of the program."""
        lines: list[Line] = []
        inside = ""
        for line in self.lines:
            word = _O_WORD.match(_bare(line))
            if word is not None and word.group(2).upper() in ("SUB", "ENDSUB"):
                inside = word.group(1) if word.group(2).upper() == "SUB" else ""
            elif not inside:
                lines.append(line)
                if _END.search(_bare(line)):
                    tail = self.lines[-1]
                    return [*lines, tail] if tail.text.strip() == "%" and tail != line else lines
        return lines

    def body(self, call: Call, line: Line) -> list[Line] | None:
        """See `Inliner.body`."""
        lines = self._body_of(call)
        if lines is None:
            return None
        changed = self._assigned(lines, 0) & {
            key_of(name) for value in call.values for name in _PARAMETER.findall(value)
        }
        if changed:
            what = f"the subprogram changes {min(changed)}, which is a value of its call"
            raise refused(what, "values that the subprogram does not change", line)
        return self._with_values(call, lines, line)

    def _body_of(self, call: Call) -> list[Line] | None:
        """Return `_body`, searched once."""
        key = (call.name, call.outside)
        if key not in self._bodies:
            self._bodies[key] = self._body(call)
        return self._bodies[key]

    def _assigned(self, lines: Sequence[Line], depth: int) -> set[str]:
        """Return the ``#`` variables that lines, or the subprograms that they call, assign."""
        assigned = {key_of(name) for line in lines for name in _ASSIGNED.findall(_NOTES.sub("", line.text))}
        for line in lines if depth < DEEPEST else ():
            call = self.call(line)
            if call is not None:
                assigned |= self._assigned(self._body_of(call) or (), depth + 1)
        return assigned

    def _body(self, call: Call) -> list[Line] | None:
        """Return the lines of a subprogram as written; None if there is no such subprogram."""
        lines = None if call.outside else self._inside(call.name)
        if lines is None:
            path = self._file(call.name)
            if path is None or str(path) == self.program.source:
                return None
            lines = self.read_file(path)
            if any(_O_WORD.match(_bare(line)) for line in lines):
                lines = _between(lines, call.name)
        return _until_return(lines)

    def _inside(self, name: str) -> list[Line] | None:
        """Return the lines of a subprogram in the main file: after ``O1000``, or between ``o100 sub`` and ``o100 endsub``."""
        subs = _between(self.lines, name)
        if subs:
            return subs
        for i, line in enumerate(self.lines):
            number = _O_NUMBER.match(_bare(line))
            if number is not None and i and f"O{int(number.group(1))}" == name:
                return self.lines[i + 1 :]
        return None

    def _file(self, name: str) -> Path | None:
        stem = name[2:-1] if name.startswith("O<") else re.split(r"[\\/:]", name)[-1]
        stems = [stem]
        if re.fullmatch(r"O\d+", name):
            stems += [f"O{int(name[1:]):04d}", name[1:]]
        stems += [f"_N_{stem}_SPF"]
        return self.file_named(*(one + suffix for one in stems for suffix in _SUFFIXES))

    def _with_values(self, call: Call, lines: Sequence[Line], at: Line) -> list[Line]:
        """Return a body with its parameters replaced by the values of the call."""
        values: dict[str, str] = {}
        found: list[Line] = []
        for line in lines:
            proc = _PROC.match(line.text[_NUMBER.match(line.text).end() :])  # type: ignore[union-attr]
            if proc is not None:
                if re.search(r"\bSAVE\b", proc.group(3), _FLAGS):
                    raise refused("subprogram that restores modal words (SAVE)", "one without SAVE", line)
                values = _parameters(proc.group(2) or "", call.values, line)
                continue
            if re.match(r"[ \t]*(?:N\d+[ \t]*)?DEF\b", line.text, _FLAGS):
                raise refused("subprogram with variables of its own", "variables defined in the main program", line)
            found.append(line)
        if not values:
            values = {f"#{i}": value for i, value in enumerate(call.values, 1)}
        if not call.outside:
            found = [_with_names_of(call.name, line) for line in found]
        return [_replaced(line, values) for line in found]

    def comment(self, text: str) -> str:
        """See `Inliner.comment`."""
        if self.call(Line(text, "", 0)).outside:  # type: ignore[union-attr]  # only calls are made comments
            return with_ending(f"; {as_comment(text, '')}", text)
        return with_ending(f"({as_comment(text, '()')})", text)


def _bracketed(text: str, line: Line) -> list[str]:
    """Return the values ``[..] [..]`` of a call.

    Raises:
        InputError: something else stands between them, or a bracket is not closed.
    """
    values, depth, begin = list[str](), 0, 0
    for at, character in enumerate(text):
        depth += (character == "[") - (character == "]")
        if depth == 1 and character == "[":
            begin = at
        elif depth == 0 and character == "]":
            values.append(text[begin : at + 1])
        elif depth <= 0 and not character.isspace():
            break
    if depth or "".join(key_of(value) for value in values) != key_of(text):
        raise refused("subprogram call", "values between brackets, and nothing else", line)
    return values


def _with_names_of(name: str, line: Line) -> Line:
    """Return a line of a subprogram whose named parameters are its own (LinuxCNC: ``#<depth>``, but not ``#<_depth>``)."""
    own = re.sub(r"\W", "", name)
    return line._replace(text=re.sub(r"#[ \t]*<[ \t]*([^\s_>][^>]*)>", rf"#<{own}_\1>", line.text))


def _bare(line: Line) -> str:
    return _NOTES.sub("", line.text[_NUMBER.match(line.text).end() :]).strip()  # type: ignore[union-attr]


def _words(bare: str) -> list[tuple[str, str]]:
    return [(letter.upper(), value) for letter, value in _WORD.findall(bare)]


def _locals(values: Mapping[int, str]) -> list[str]:
    """Return the values of the local variables of a macro; those that have none are vacant (``#0``)."""
    return [values.get(i, "#0") for i in range(1, _LOCALS + 1)]


def _arguments(text: str | None) -> list[str]:
    """Return the arguments of ``NAME(a, b)``."""
    inner = "" if text is None else text.strip()[1:-1]
    return [part.strip() for part in inner.split(",")] if inner.strip() else []


def _between(lines: Sequence[Line], name: str) -> list[Line]:
    """Return the lines between ``o<name> sub`` and its end."""
    between: list[Line] = []
    inside = False
    for line in lines:
        word = _O_WORD.match(_bare(line))
        if word is not None and f"O{word.group(1)}".upper() == name.upper() and word.group(2).upper() != "CALL":
            if inside:
                return between
            inside = word.group(2).upper() == "SUB"
        elif inside:
            between.append(line)
    return between


def _until_return(lines: Sequence[Line]) -> list[Line]:
    """Return the lines of a subprogram up to its end, without it, its number and tape marks."""
    until_return: list[Line] = []
    for line in lines:
        bare = _bare(line)
        if _RETURN.fullmatch(bare):
            return until_return
        if _RETURN.search(bare) and not bare.startswith("("):
            raise refused("return in a block with other words", "M99, M17 or RET in a block of its own", line)
        if _O_NUMBER.match(bare):
            if until_return:
                return until_return
        elif bare != "%":
            until_return.append(line)
    return until_return


def _parameters(text: str, values: Sequence[str], line: Line) -> dict[str, str]:
    """Return the values of ``REAL A, INT B=2`` by name."""
    parameters: dict[str, str] = {}
    for place, part in enumerate(part.strip() for part in text.split(",") if part.strip()):
        declared = re.fullmatch(r"(?:REAL|INT)[ \t]+(\w+)(?:[ \t]*=[ \t]*(\S+))?", part, _FLAGS)
        value = values[place] if place < len(values) and values[place] else None
        if declared is None or (value is None and declared.group(2) is None):
            raise refused("parameter without a value", "a call with a value for each REAL or INT parameter", line)
        parameters[declared.group(1).upper()] = f"({value or declared.group(2)})"
    return parameters


def _replaced(line: Line, values: Mapping[str, str]) -> Line:
    """Return a line with parameters replaced; raise `InputError` if it assigns one."""
    if not values:
        return line

    def value(match: re.Match[str]) -> str:
        text = values.get(match.group().upper())
        if text is None:
            return match.group()
        if re.match(r"[ \t]*=(?!=)", line.text[match.end() :]):
            raise refused(
                f"the subprogram changes its parameter {match.group()}", "parameters that keep their value", line
            )
        return text

    return line._replace(text=re.sub(r"#\d+(?!\d)|(?<![\w$#])[A-Za-z_]\w*", value, line.text))
