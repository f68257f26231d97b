"""Meaning of a column's header: which quantity of a measurement table it gives, and in which unit."""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from twin.machine.machine import Machine
from twin.measurement.columns import ANGLE_COLUMNS, PLACE_COLUMNS, STATION_COLUMNS, table_columns
from twin.measurement.importing.units import table_unit, unit_named
from twin.measurement.importing.vocabulary import NAMES, NOISE, ROLES, plain_words
from twin.measurement.table import CHANNEL

_BRACKETS: Final = re.compile(r"\s*[\[({<]\s*([^\])}>]*?)\s*[\])}>]\s*$")
_SUFFIX: Final = re.compile(r"(?:\s+in\s+|\s*[/,]\s*|\s+|_)([^\s_,/]+(?:/min)?)$")
_CAMEL: Final = re.compile(r"(?<=[a-zäöü])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-zäöü])")


class Meaning(NamedTuple):
    """Meaning of a header.

    Attributes:
        kind: ``exact`` (a column of a measurement table), a role (`twin.measurement.importing.vocabulary.ROLES`), ``bare`` (an axis
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
    text, unit = _without_unit(header)
    words = _words(text, machine)
    joined = " ".join(words)
    for kind, phrases in NAMES.items():
        if joined in phrases and not (joined in ("", "t") and unit.casefold() in ("°c", "degc", "k", "c")):
            return Meaning(kind, kind, unit)
    axes = {axis.casefold(): axis for axis in machine.names}
    found = [word for word in words if word in axes or word in ("x", "y", "z")]
    rest = [word for word in words if word not in found and word not in NOISE]
    temperature = ROLES["temperature"] & {*rest} or table_unit(f"_{_table_unit(unit)}") == "degC"
    if temperature:
        name = "_".join(word for word in [*found, *rest] if word not in ROLES["temperature"]) or "air"
        return Meaning("temperature", axes.get(name, name), unit)
    if len(found) != 1:
        role = next(
            (role for role, known in ROLES.items() if {*rest} & known and role in ("approach", "deviation")), ""
        )
        return Meaning(role, "", unit)
    axis = axes.get(found[0], found[0])
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


def _table_unit(text: str) -> str:
    unit = unit_named(text)
    return "" if unit is None else unit.table_unit


def _without_unit(header: str) -> tuple[str, str]:
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
    for word in words:
        axis = next((axis for axis in axes if word.startswith(axis) and word[len(axis) :] in roles - {"t", "u"}), None)
        last = next((axis for axis in axes if word.endswith(axis) and word[: -len(axis)] in roles - {"t"}), None)
        if word in roles or word in axes or (axis is None and last is None):
            found.append(word)
        elif axis is not None:
            found += [axis, word[len(axis) :]]
        elif last is not None:
            found += [word[: -len(last)], last]
    return found
