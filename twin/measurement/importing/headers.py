"""Meaning of a column's header: which quantity of a measurement table it gives, and in which unit."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import yaml

from twin.machine.machine import Machine
from twin.measurement.columns import ANGLE_COLUMNS, PLACE_COLUMNS, STATION_COLUMNS, table_columns
from twin.measurement.importing.quantities import unit_named
from twin.measurement.table import CHANNEL

Words = frozenset[str]


def _words_of(part: Any) -> Any:
    """Return a part of the vocabulary with its words, which are separated by commas, as sets."""
    if isinstance(part, dict):
        return MappingProxyType({name: _words_of(words) for name, words in part.items()})
    return frozenset(word.strip() for word in part.split(","))


_VOCABULARY: Final = _words_of(yaml.safe_load(Path(__file__).with_name("vocabulary.yaml").read_text(encoding="utf-8")))
ROLES: Final[Mapping[str, Words]] = _VOCABULARY["roles"]
"""Role of a column, by its words beside the name of an axis."""
NAMES: Final[Mapping[str, Words]] = MappingProxyType(
    {kind: words | {""} if kind == "index" else words for kind, words in _VOCABULARY["names"].items()}
)
"""Meaning of a column without the name of an axis, by its words; a column without a name is an index."""
CARRIER_WORDS: Final[Mapping[str, str]] = MappingProxyType(
    {word: side for side, words in _VOCABULARY["carriers"].items() for word in words}
)
"""Sides of the machine, by the words of a cell."""
UP_WORDS, DOWN_WORDS, UNKNOWN_WORDS = (_VOCABULARY["directions"][name] for name in ("up", "down", "unknown"))
"""Words of a cell that give the direction of approach: towards larger positions, towards smaller ones, unknown."""
GEODETIC: Final[Mapping[str, str]] = MappingProxyType(
    {"easting": "x", "rechtswert": "x", "northing": "y", "hochwert": "y", "height": "z", "hoehe": "z"}
)
"""Coordinates of geodetic instruments: east, north and up are a right-handed frame."""
_LETTERS: Final = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss"})
_ARROWS: Final = str.maketrans({"−": "-", "–": "-", "↑": "+", "→": "+", "↓": "-", "←": "-"})


def plain_words(text: str) -> str:
    """Return a text in lower case with German letters written as two, and other letters without accents."""
    plain = text.casefold().translate(_LETTERS).strip()
    return "".join(sign for sign in unicodedata.normalize("NFD", plain) if not unicodedata.combining(sign))


def direction_of(cell: str) -> int | None:
    """Return +1, −1 or 0 (unknown) for a cell that gives a direction of approach; None if it gives none."""
    word = plain_words(cell).translate(_ARROWS).strip("() ") if cell.strip("() ") else ""
    word = word.rstrip(".") or word
    if word in UP_WORDS:
        return 1
    if word in DOWN_WORDS:
        return -1
    return 0 if not word or word in UNKNOWN_WORDS else None


# --- Meaning of a column's header: which quantity of a measurement table it gives, and in which unit

_BRACKETS: Final = re.compile(r"\s*[\[({<]\s*([^\])}>]*?)\s*[\])}>]\s*$")
_SUFFIX: Final = re.compile(r"(?:\s+in\s+|\s*[/,]\s*|\s+|_)([^\s_,/]+(?:/min)?)$")
_CAMEL: Final = re.compile(r"(?<=[a-zäöü])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-zäöü])")


class Meaning(NamedTuple):
    """Meaning of a header.

    Attributes:
        kind: ``exact`` (a column of a measurement table), a role (`twin.measurement.importing.headers.ROLES`), ``bare`` (an axis
            without a role), a name (`NAMES`), ``sensor`` (a temperature), or empty if unknown.
        name: name of the column, axis or sensor.
        unit: unit that the header gives; empty if none.
        certain: whether all words are known.
    """

    kind: str = ""
    name: str = ""
    unit: str = ""
    certain: bool = True


def table_names(machine: Machine) -> tuple[str, ...]:
    """Return the columns that a measurement table of this machine can have, without temperatures and channels."""
    angles = tuple(f"{prefix}{name}" for prefix in ("", "u_") for name in ANGLE_COLUMNS)
    return (
        *(name for part in table_columns(machine) for name in part.columns),
        *angles,
        *PLACE_COLUMNS,
        *STATION_COLUMNS,
    )


def is_table_column(name: str, machine: Machine) -> bool:
    """Return whether a measurement table of this machine can have a column of this name."""
    return name in table_names(machine) or bool(re.fullmatch(r"T_.+_degC", name) or CHANNEL.fullmatch(name))


def meaning_of(header: str, machine: Machine) -> Meaning:
    """Return the meaning of a header."""
    if is_table_column(header, machine):
        return Meaning("exact", header)
    text, unit = without_unit(header)
    words = _words(text, machine)
    joined = " ".join(words)
    short = " ".join(word for word in words if word not in _VOCABULARY["numbering"]) or joined
    for kind, phrases in NAMES.items():
        is_named = joined in phrases or (kind in ("target", "station", "round") and short in phrases)
        if is_named and not (joined in ("", "t") and unit.casefold() in ("°c", "degc", "k", "c")):
            return Meaning(kind, kind, unit)
    axes = {axis.casefold(): axis for axis in machine.names}
    meant = [word for word in words if word in axes or word in ("x", "y", "z")]
    rest = [word for word in words if word not in meant and word not in _VOCABULARY["noise"]]
    known = unit_named(unit)
    temperature = ROLES["temperature"] & {*rest} or (known is not None and known.table_unit == "degC")
    if temperature:
        name = "_".join(word for word in [*meant, *rest] if word not in ROLES["temperature"]) or "air"
        return Meaning("temperature", axes.get(name, name), unit)
    if len(meant) != 1:
        order = ("approach", "deviation", "measured", "command") if not meant else ("approach", "deviation")
        return Meaning(next((role for role in order if {*rest} & ROLES[role]), ""), "", unit)
    axis = axes.get(meant[0], meant[0])
    if not rest:
        return Meaning("bare", axis, unit)
    roles = [
        role
        for role in ("deviation", "uncertainty", "approach", "readback", "command", "measured")
        if ROLES[role] & {*rest}
    ]
    if not roles:
        # Few programs give anything but the position of a rotary axis; a linear axis has offsets, corrections and more.
        is_rotary = axis in machine.by_name and not machine.by_name[axis].linear
        return Meaning("bare" if is_rotary else "", axis, unit, certain=not is_rotary)
    role = roles[0]
    return Meaning(role, axis, unit, certain=len(roles) == 1 and all(word in ROLES[role] for word in rest))


def other_axis(header: str, machine: Machine) -> str:
    """Return the letter of a rotary axis A, B or C that a header names as a position and the machine does not have; empty if none."""
    text = header.removesuffix("_deg") if re.fullmatch("[A-C]_deg", header) else without_unit(header)[0]
    words = [
        word for word in _words(text, machine) if word not in _VOCABULARY["noise"] and word not in ROLES["command"]
    ]
    letter = words[0].upper() if len(words) == 1 else ""
    return letter if letter in ("A", "B", "C") and letter not in machine.by_name else ""


def without_unit(header: str) -> tuple[str, str]:
    """Return a header without its unit, and the unit; empty if it gives none."""
    for pattern in (_BRACKETS, _SUFFIX):
        match = pattern.search(header)
        if match and match.start() and unit_named(match[1]) is not None and len(match[1]) + (pattern is _BRACKETS) > 1:
            return header[: match.start()], match[1]
    match = re.fullmatch(r"(.*\S)\s*([°µ\"]\S*)", header)
    if match and unit_named(match[2]) is not None:
        return match[1], match[2]
    return header, ""


def _words(text: str, machine: Machine) -> list[str]:
    """Return the words of a name in lower case; ``XIst``, ``x_ist`` and ``Xist`` give two words."""
    split = _CAMEL.sub(" ", text)
    words = [word for word in re.split(r"[^a-z0-9+]+", plain_words(split)) if word]
    axes = {"x", "y", "z", *(axis.casefold() for axis in machine.names)}
    roles = frozenset().union(*ROLES.values())
    found = []
    for word in (GEODETIC.get(word, word) for word in words):
        axis = next((axis for axis in axes if word.startswith(axis) and word[len(axis) :] in roles - {"t", "u"}), None)
        last = next((axis for axis in axes if word.endswith(axis) and word[: -len(axis)] in roles - {"t"}), None)
        if word in roles or word in axes or (axis is None and last is None):
            found.append(word)
        elif axis is not None:
            found += [axis, word[len(axis) :]]
        elif last is not None:
            found += [word[: -len(last)], last]
    return found
