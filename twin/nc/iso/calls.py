"""Subprograms of ISO programs: Fanuc ``M98`` and ``G65``, LinuxCNC ``o100 call``, SINUMERIK ``NAME(..)``, ``L100`` and ``CALL``.

Sources: Fanuc Series 30i operator's manual ("Subprogram", "Custom macro"), LinuxCNC user manual ("O Codes"), SINUMERIK 840D sl
Programming Manual Job Planning ("Subprograms", "EXTCALL").
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, final

import numpy as np

from twin.nc.arithmetic import evaluate, key_of
from twin.nc.blocks import Program
from twin.nc.dialect import as_comment
from twin.nc.inline import RETURN, Call, Flow, Inliner, Line, Scope, refused, with_ending
from twin.nc.iso import vocabulary
from twin.nc.iso.cycles import SINUMERIK

_FLAGS: Final = re.ASCII | re.IGNORECASE
_NUMBER: Final = re.compile(r"[ \t]*(?:N\d+[ \t]*)?", _FLAGS)
_NOTES: Final = re.compile(rf"{vocabulary.NOTE}|;.*", re.DOTALL)
_FANUC: Final = re.compile(r"M[ \t]*1?98(?!\d)", _FLAGS)
_WORD: Final = re.compile(rf"([A-Z])[ \t]*([+-]?[\d.]+|[+-]?#\d+|[+-]?{vocabulary.BRACKET})", _FLAGS)
_MACRO: Final = re.compile(r"G[ \t]*65(?![\d.])", _FLAGS)
_END: Final = re.compile(r"(?<![A-Z\d])M[ \t]*0*(?:2|30)(?!\d)", _FLAGS)
_RETURN: Final = re.compile(r"(?<!\w)(?:M[ \t]*0*(?:99|17|30|2)(?![\d=])|RET(?!\w))", _FLAGS)
_CALL_AT_BEGIN: Final = r"[ \t]*(?:[Nn]\d+[ \t]*)?(?:[Oo][ \t]*[\d<]|[Ll][ \t]*\d|[A-Za-z_][A-Za-z_])"
_LIKELY: Final = re.compile(_CALL_AT_BEGIN, re.ASCII)
_INSIDE: Final = re.compile(r"M[ \t]*1?98|G[ \t]*65", _FLAGS)
_LIKELY_WITHIN: Final = re.compile(rf"[\r\n]{_CALL_AT_BEGIN}", re.ASCII)
"""The first of these two at the begin of a line; quick, because letters of both cases are written out."""
_LOCALS: Final = 33
"""Number of local variables of a macro of Fanuc."""
_O_LOCALS: Final = 30
"""Number of those of a subprogram of LinuxCNC."""
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
_O_FLOW: Final = re.compile(
    r"O[ \t]*(\d+|<[^>]*>)[ \t]*(IF|ELSEIF|ELSE|ENDIF|WHILE|ENDWHILE|DO|REPEAT|ENDREPEAT|BREAK|CONTINUE)(?![A-Z])[ \t]*(.*)",
    _FLAGS | re.DOTALL,
)
_TARGET: Final = r"GOTO([FBCS]?)[ \t]*([A-Z_]\w*|:?\d+)"
_JUMP: Final = re.compile(rf"(?:IF(?!\w)(.*?)(?<![A-Z]))?{_TARGET}[ \t]*", _FLAGS)
_THEN: Final = re.compile(r"IF[ \t]*(\[.*\])[ \t]*THEN[ \t]*(.+)", _FLAGS)
_DO: Final = re.compile(r"(?:WHILE[ \t]*(\[.*\])[ \t]*)?DO[ \t]*(\d)", _FLAGS)
_END_DO: Final = re.compile(r"END[ \t]*(\d)", _FLAGS)
_FOR: Final = re.compile(r"FOR[ \t]+([A-Z_]\w*)[ \t]*=(.+?)(?<!\w)TO(?!\w)(.+)", _FLAGS)
_PART: Final = re.compile(r"REPEAT(B?)[ \t]+([A-Z_]\w*)(?:[ \t]+([A-Z_]\w*))?(?:[ \t]+P[ \t]*=?[ \t]*(\S+))?", _FLAGS)
_CASE: Final = re.compile(r"CASE(?!\w)(.+?)(?<!\w)OF(?!\w)(.+)", _FLAGS)
_WHEN: Final = re.compile(rf"[ \t]*(DEFAULT|\S+)[ \t]+{_TARGET}", _FLAGS)
_UNIT: Final = re.compile(r"%_N_(\w+?)_([MS]PF)(?!\w)", _FLAGS)
_OFF: Final = ("$P_SIM", "$P_ISTEST", "$P_SEARCH", "$P_DRYRUN")
"""System variables of SINUMERIK that are 0 while a program runs: simulation, test, block search, dry run."""
_LABEL: Final = re.compile(r"([ \t]*(?:N\d+[ \t]*)?)([A-Z_]{2}\w*)[ \t]*:(?!=)", _FLAGS)
_NUMBERED: Final = re.compile(r"[ \t]*(?:N|:)[ \t]*0*(\d+)", _FLAGS)
_TOWARDS: Final = {"F": 1, "B": -1}
_O_KINDS: Final = {"ENDWHILE": "end", "ENDREPEAT": "end"}
_VACANT: Final = re.compile(r"\[?[ \t]*(.+?)[ \t]*(EQ|NE)[ \t]*#0[ \t]*\]?", _FLAGS)
_OPERATOR: Final = re.compile(r"(?<=[\d\]])(EQ|NE|GT|GE|LT|LE|AND|OR|XOR|MOD)(?=[-+\d.#\[])", _FLAGS)
_SIEMENS: Final = re.compile(r"(?:IF|WHILE|UNTIL|FOR|CASE)(?!\w)[ \t]*[^\[ \t]", _FLAGS)
"""A statement of SINUMERIK whose round brackets are no comments."""
_DEFINED: Final = re.compile(r"[ \t]*(?:N\d+[ \t]*)?DEF[ \t]+(?:REAL|INT|BOOL)[ \t]+([^;]*)", _FLAGS)
_LOCAL: Final = re.compile(r"#\d+(?!\d)|(?<![\w$#])[A-Za-z_]\w*")
_GIVEN: Final = re.compile(rf"{_LOCAL.pattern}|#<[^>]*>")
_FANUC_JUMP: Final = re.compile(r"(?:GOTO|DO|WHILE[ \t]*\[)[ \t]*\d?", _FLAGS)
_OWN: Final = "\0"
"""Mark of the scope of a subprogram that has variables of its own."""
_SAVES: Final = re.compile(r"(?<![A-Z\d])M[ \t]*0*7[0-3](?![\d=])", _FLAGS)
"""Words of LinuxCNC that save and restore modal words, which its subprograms have for themselves."""
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
        self.values |= dict.fromkeys(_OFF, 0.0)
        self._linuxcnc = False
        self._bodies: dict[tuple[str, bool], list[Line] | None] = {}

    def likely(self, text: str) -> bool:
        """See `Inliner.likely`."""
        inside = ("98" in text or "65" in text) and _INSIDE.search(text) is not None
        return inside or text == RETURN or _LIKELY.match(text) is not None

    def likely_within(self, text: str) -> bool:
        """See `Inliner.likely_within`."""
        lines = "\n" + text
        return _LIKELY_WITHIN.search(lines) is not None or _may_call_inside(lines)

    def call(self, line: Line) -> Call | None:
        """See `Inliner.call`."""
        if not self.likely(line.text) or line.text == RETURN:
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
            return Call(
                f"O{word.group(1)}", values=_locals(dict(enumerate(_bracketed(word.group(3), line), 1)), _O_LOCALS)
            )
        named = _NAMED.match(text.split(";")[0].strip())
        if named is None or (named.group(2) or "").upper() in _STATEMENTS:
            return None
        name = named.group(1) or named.group(2)
        inner = (named.group(3) or "").strip()[1:-1]
        values = [part.strip() for part in inner.split(",")] if inner.strip() else []
        certain = named.group(1) is not None or re.fullmatch(r"L\d+", name, _FLAGS) is not None
        return Call(name, int(named.group(4) or 1), values, outside=True, certain=certain)

    def _fanuc(self, line: Line, bare: str) -> Call:
        words = {letter.upper(): value for letter, value in _WORD.findall(bare)}
        if set(words) - {"M", "P", "L"} or not words.get("P", "").isdigit() or not words.get("L", "1").isdigit():
            raise refused("subprogram call", "a block with only M98, P and L", line)
        digits, repeats = words["P"], int(words.get("L", "1"))
        if len(digits) > 4 and "L" not in words:
            digits, repeats = digits[-4:], int(digits[:-4])
        return Call(f"O{int(digits)}", repeats, own=False)

    def _macro(self, line: Line, bare: str) -> Call:
        words = [(letter.upper(), value) for letter, value in _WORD.findall(bare)]
        values = dict(words)
        if len(values) < len(words) or not values.get("P", "").isdigit() or not values.get("L", "1").isdigit():
            raise refused("macro call", "G65 with a program number P, a whole number L, and each argument once", line)
        unknown = set(values) - set(_ARGUMENTS) - {"G", "P", "L"}
        if unknown:
            raise refused("macro call", f"arguments other than {' '.join(sorted(unknown))}", line)
        given = {
            _ARGUMENTS[letter]: value if value.startswith("[") else f"[{value}]"
            for letter, value in values.items()
            if letter in _ARGUMENTS
        }
        return Call(f"O{int(values['P'])}", int(values.get("L", "1")), _locals(given, _LOCALS))

    def flow(self, line: Line) -> Flow | None:
        """See `Inliner.flow`."""
        if line.text == RETURN:
            return Flow("return")
        text = line.text[_NUMBER.match(line.text).end() :]  # type: ignore[union-attr]
        label = _LABEL.match(text)
        text = text if label is None else text[label.end() :].lstrip()
        bare = text.split(";")[0].strip() if _SIEMENS.match(text) else _NOTES.sub("", text).strip()
        if label is not None and not bare:
            return Flow("label")
        word = _O_FLOW.match(bare)
        if word is not None:
            self._linuxcnc, kind = True, word.group(2).upper()
            return Flow(_O_KINDS.get(kind, kind.lower()), key_of(f"O{word.group(1)}"), word.group(3).strip())
        for pattern, made in _FLOWS.items():
            if (match := pattern.fullmatch(bare)) is not None:
                return made(match)
        return _simple_flow(bare)

    def labels(self, line: Line) -> list[str]:
        """See `Inliner.labels`."""
        number, label = _NUMBERED.match(line.text), _LABEL.match(line.text)
        return [
            *([] if number is None else [f"N{number.group(1)}"]),
            *([] if label is None else [label.group(2).upper()]),
        ]

    def value(self, text: str) -> float:
        """See `Inliner.value`; a vacant parameter (``#0``) of Fanuc can be compared with another parameter."""
        text = _OPERATOR.sub(r" \1 ", text)
        vacant = _VACANT.fullmatch(text)
        if vacant is None or self._linuxcnc:
            return evaluate(text, self.values, linuxcnc=self._linuxcnc)
        known = evaluate(vacant.group(1), self.values)
        if vacant.group(1) != "#0" and known != known:
            return math.nan
        return float((vacant.group(1) == "#0") == (vacant.group(2).upper() == "EQ"))

    def assign(self, line: Line) -> None:
        """See `Inliner.assign`; the values of ``#`` parameters hold from the next block on."""
        if "=" not in line.text:
            return
        defined = _DEFINED.match(line.text)
        if defined is not None:
            new = [
                (name, evaluate(value, self.values)) for name, value in vocabulary.ASSIGNED.findall(defined.group(1))
            ]
        else:
            new = []
            for name, text, _ in _assignments(line.text):
                value = evaluate(text, self.values)
                if name.startswith("#"):
                    new.append((name, value))
                else:
                    self.values[key_of(name)] = value
        self.values.update((key_of(name), value) for name, value in new)

    def plain(self, line: Line, scope: Scope) -> Line:
        """See `Inliner.plain`."""
        label = _LABEL.match(line.text) if ":" in line.text else None
        if label is not None and not line.text.startswith("("):
            line = line._replace(text=label.group(1) + line.text[label.end() :].lstrip(" \t"))
        if not scope:
            return line
        defined = _DEFINED.match(line.text)
        if defined is not None and scope.get(_OWN) is not None:
            for part in defined.group(1).split(","):
                name, _, value = part.partition("=")
                scope[key_of(name)] = _literal(self.value(_with_literals(value, scope, line)) if value else 0.0, name)
            return line._replace(text=self.comment(line.text))
        text, rest, new = line.text, "", dict[str, str]()
        at, alone = 0, False
        for name, value, (begin, end) in _assignments(text):
            if key_of(name) in scope:
                literal = _literal(self.value(_with_literals(value, scope, line)), name)
                (new if name.startswith("#") else scope)[key_of(name)] = literal
                alone = True
                rest += text[at:begin]
                at = end
        rest = _with_literals(rest + text[at:], scope, line)
        scope.update(new)
        alone = alone and not _bare(line._replace(text=rest))
        return line._replace(text=self.comment(line.text) if alone else rest)

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
                    lines += self._behind(lines)
                    return [*lines, tail] if tail.text.strip() == "%" and tail != lines[-1] else lines
        return lines

    def _behind(self, lines: Sequence[Line]) -> list[Line]:
        """Return the lines behind the first end of the program, up to a subprogram, if a jump among those before leads there."""
        flows = [self.flow(line) for line in lines if self.likely(line.text)]
        targets = {flow.name for flow in flows if flow is not None and flow.kind == "goto"}
        if targets <= {name for line in lines for name in self.labels(line)}:
            return []
        behind = itertools.takewhile(lambda line: not _O_NUMBER.match(_bare(line)), self.lines[lines[-1].number :])
        return [line for line in behind if line.text.strip() != "%"]

    def ends(self, line: Line) -> bool:
        """See `Inliner.ends`."""
        return _END.search(_bare(line)) is not None

    def body(self, call: Call, line: Line) -> list[Line] | None:
        """See `Inliner.body`."""
        lines = self._body_of(call)
        if lines is None:
            return None
        return self._with_values(call, lines, changes=self._changes(call, lines))

    def scope(self, call: Call, line: Line) -> Scope:
        """See `Inliner.scope`: all local parameters if the subprogram changes one of them."""
        lines = self._body_of(call) or []
        if not self._changes(call, lines):
            return {}
        scope = {_OWN: ""}
        for name, text in _local_values(call, lines).items():
            scope[key_of(name)] = text if text == "#0" else _literal(self.value(text), name)
        return scope

    def _changes(self, call: Call, lines: Sequence[Line]) -> bool:
        """Return whether a subprogram has variables of its own, or changes a local parameter or a value of its call."""
        if call.name in self._called:
            return True
        if not call.own or any(_DEFINED.match(line.text) for line in lines):
            return call.own
        own = {key_of(name) for name in _local_values(call, lines)}
        given = {key_of(name) for value in call.values for name in _GIVEN.findall(value)}
        return bool(self._assigned(lines, {call.name}) & (own | given))

    def _body_of(self, call: Call) -> list[Line] | None:
        """Return `_body`, searched once."""
        key = (call.name, call.outside)
        if key not in self._bodies:
            self._bodies[key] = self._body(call)
        return self._bodies[key]

    def _assigned(self, lines: Sequence[Line], seen: set[str]) -> set[str]:
        """Return the ``#`` variables that lines assign, or the subprograms that they call, unless ``seen`` has their names."""
        assigned = {key_of(name) for line in lines if "=" in line.text for name, _, _ in _assignments(line.text)}
        for call in filter(None, map(self.call, lines)):
            if call.name not in seen:
                seen.add(call.name)
                assigned |= self._assigned(self._body_of(call) or (), seen)
        return assigned

    def _body(self, call: Call) -> list[Line] | None:
        """Return the lines of a subprogram as written; None if there is no such subprogram."""
        lines = self._in_archive(call.name) if call.outside else self._inside(call.name)
        if lines is None:
            path = self._file(call.name)
            if path is None or str(path) == self.program.source:
                return None
            lines = self.read_file(path)
            if any(_O_WORD.match(_bare(line)) for line in lines):
                lines = _between(lines, call.name)
        saves = (
            None if not call.own or call.outside else next((one for one in lines if _SAVES.search(_bare(one))), None)
        )
        if saves is not None:
            raise refused(
                "modal words saved in a subprogram", "M70 to M73 outside subprograms: each has its own", saves
            )
        return _until_return(lines, any(self.likely(line.text) and self.flow(line) for line in lines))

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

    def _in_archive(self, name: str) -> list[Line] | None:
        """Return the lines of a subprogram of SINUMERIK in the main file: behind ``%_N_NAME_SPF``, up to the next such line."""
        stem = re.split(r"[\\/:]", name)[-1].upper()
        begins = [line.number for line in self.lines if line.text.startswith("%_N_")]
        for begin, end in itertools.pairwise([*begins, len(self.lines) + 1]):
            unit = _UNIT.match(self.lines[begin - 1].text)
            if unit is not None and stem in (unit[1].upper(), f"_N_{unit[1].upper()}_{unit[2].upper()}"):
                return self.lines[begin : end - 1]
        return None

    def _file(self, name: str) -> Path | None:
        stem = name[2:-1] if name.startswith("O<") else re.split(r"[\\/:]", name)[-1]
        stems = [stem]
        if re.fullmatch(r"O\d+", name):
            stems += [f"O{int(name[1:]):04d}", name[1:]]
        stems += [f"_N_{stem}_SPF"]
        return self.file_named(*(one + suffix for one in stems for suffix in _SUFFIXES))

    def _with_values(self, call: Call, lines: Sequence[Line], *, changes: bool) -> list[Line]:
        """Return a body with its parameters replaced by the values of the call, unless it ``changes`` them."""
        found = [line for line in lines if _proc(line) is None]
        if not call.outside:
            # Named parameters of a subprogram are its own (LinuxCNC: ``#<depth>``, but not ``#<_depth>``).
            within = self._called.count(call.name)
            own = re.sub(r"\W", "", f"{call.name}{f'_{within}' if within else ''}")
            texts = (re.sub(r"#[ \t]*<[ \t]*([^\s_>][^>]*)>", rf"#<{own}_\1>", line.text) for line in found)
            found = [line._replace(text=text) for line, text in zip(found, texts, strict=True)]
        values = {} if changes else _local_values(call, lines)
        if not values:
            return found
        texts = (
            _LOCAL.sub(lambda match: values.get(match.group().upper(), match.group()), line.text) for line in found
        )
        return [line._replace(text=text) for line, text in zip(found, texts, strict=True)]

    def comment(self, text: str) -> str:
        """See `Inliner.comment`."""
        if text == RETURN:
            return "(return)\n"
        line = Line(text, "", 0)
        call, bare = self.call(line), _bare(line)
        brackets = "#" in bare or any((_O_FLOW.match(bare), _END_DO.fullmatch(bare), _FANUC_JUMP.match(bare)))
        if call.outside if call is not None else not brackets:
            return with_ending(f"; {as_comment(text, '')}", text)
        return with_ending(f"({as_comment(text, '()')})", text)


def _bracketed(text: str, line: Line) -> list[str]:
    """Return the values ``[..] [..]`` of a call; raise `InputError` if anything else stands there."""
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


def _bare(line: Line) -> str:
    return _NOTES.sub("", line.text[_NUMBER.match(line.text).end() :]).strip()  # type: ignore[union-attr]


def _locals(values: Mapping[int, str], count: int) -> list[str]:
    """Return the values of the local variables of a macro; those that have none are vacant (``#0``)."""
    return [values.get(i, "#0") for i in range(1, count + 1)]


def _between(lines: Sequence[Line], name: str) -> list[Line]:
    """Return the lines between ``o<name> sub`` and its end."""
    between: list[Line] = []
    inside = False
    for line in lines:
        word = _O_WORD.match(_bare(line))
        kind = "" if word is None or f"O{word.group(1)}".upper() != name.upper() else word.group(2).upper()
        if kind in ("", "CALL"):
            between += [line] if inside else []
        elif kind == "RETURN" and inside:
            between.append(line._replace(text=RETURN))
        elif inside:
            return between
        else:
            inside = kind == "SUB"
    return between


def _until_return(lines: Sequence[Line], jumps: bool) -> list[Line]:
    """Return the lines of a subprogram up to its end, without its number and tape marks; ``jumps``: whether it may return earlier."""
    until_return: list[Line] = []
    for line in lines:
        bare = _bare(line)
        if _RETURN.fullmatch(bare):
            if not jumps:
                return until_return
            until_return.append(line._replace(text=RETURN))
        elif _RETURN.search(bare) and not bare.startswith("("):
            raise refused("return in a block with other words", "M99, M17 or RET in a block of its own", line)
        elif _O_NUMBER.match(bare):
            if until_return:
                return until_return
        elif bare != "%":
            until_return.append(line)
    return until_return


def _proc(line: Line) -> re.Match[str] | None:
    """Return the match of a ``PROC`` line; raise `InputError` if its subprogram restores modal words."""
    proc = _PROC.match(line.text[_NUMBER.match(line.text).end() :])  # type: ignore[union-attr]
    if proc is not None and re.search(r"\bSAVE\b", proc.group(3), _FLAGS):
        raise refused("subprogram that restores modal words (SAVE)", "one without SAVE", line)
    return proc


def _local_values(call: Call, lines: Sequence[Line]) -> dict[str, str]:
    """Return the text of the value of each local parameter of a subprogram, by its name."""
    for line in lines:
        if (proc := _proc(line)) is not None:
            return _parameters(proc.group(2) or "", call.values, line)
    return {f"#{i}": value for i, value in enumerate(call.values, 1)}


def _assignments(text: str) -> Iterator[tuple[str, str, tuple[int, int]]]:
    """Yield the name, the value and the range of each assignment to a parameter in a line."""
    for match in vocabulary.TOKEN.finditer(text):
        if match.lastgroup == "hash":
            yield match.group(17), match.group(18), match.span()
        elif match.lastgroup == "given" and len(match.group(6)) > 1:
            yield match.group(6) + (match.group(7) or ""), match.group(8), match.span()


def _literal(value: float, name: str) -> str:
    """Return a number as text between brackets; empty for an unknown one."""
    if value != value:
        return ""
    text = f"{value:.12f}".rstrip("0").rstrip(".")
    return f"[{text}]" if name.lstrip().startswith("#") else f"({text})"


def _with_literals(text: str, scope: Scope, line: Line) -> str:
    """Return a text with the values of local parameters; raise `InputError` if one is unknown."""

    def value(match: re.Match[str]) -> str:
        name = key_of(match.group())
        if name not in scope:
            return match.group()
        if not scope[name]:
            raise refused(f"the value of {match.group()} is unknown", "a parameter set to a number before", line)
        return scope[name]

    return _LOCAL.sub(value, text)


def _simple_flow(bare: str) -> Flow | None:
    """Return a statement of SINUMERIK that begins with its name."""
    word = re.match(r"[A-Za-z]+(?!\w)", bare)
    name, rest = ("", "") if word is None else (word.group().upper(), bare[word.end() :].strip())
    if name in ("IF", "WHILE", "UNTIL") and rest:
        return Flow(name.lower(), "", rest)
    if rest:
        return None
    kinds = {"ELSE": "else", "ENDIF": "endif", "LOOP": "do", "REPEAT": "do", "ENDLOOP": "end", "ENDWHILE": "end"}
    kind = kinds.get(name, "end" if name == "ENDFOR" else "")
    return Flow(kind) if kind else None


def _label_name(text: str) -> str:
    return f"N{int(text.lstrip(':'))}" if text.lstrip(":").isdigit() else text.upper()


def _jump(match: re.Match[str]) -> Flow:
    condition = (match.group(1) or "").strip()
    return Flow("goto", _label_name(match.group(3)), "", condition, _TOWARDS.get(match.group(2).upper(), 0))


def _case(match: re.Match[str]) -> Flow:
    whens = [
        ("" if when.upper() == "DEFAULT" else when, _label_name(label), str(_TOWARDS.get(way.upper(), 0)))
        for when, way, label in _WHEN.findall(match.group(2))
    ]
    return Flow("case", "", "\0".join("\1".join(one) for one in whens), match.group(1).strip())


def _part(match: re.Match[str]) -> Flow:
    first = match.group(2).upper()
    last = first if match.group(1) else (match.group(3) or "").upper()
    return Flow("part", first, match.group(4) or "1", last)


_FLOWS: Final[Mapping[re.Pattern[str], Callable[[re.Match[str]], Flow]]] = {
    _JUMP: _jump,
    _THEN: lambda match: Flow("then", "", match.group(2), match.group(1)),
    _DO: lambda match: Flow("while" if match.group(1) else "do", f"DO{match.group(2)}", match.group(1) or ""),
    _END_DO: lambda match: Flow("end", f"DO{match.group(1)}"),
    _FOR: lambda match: Flow("for", key_of(match.group(1)), f"{match.group(2).strip()}\0{match.group(3).strip()}"),
    _PART: _part,
    _CASE: _case,
}
"""Statements of Fanuc and SINUMERIK by their pattern."""


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
