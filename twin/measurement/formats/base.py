"""Base class of the formats of other programs: one final class per format, each in its own file (`FORMATS`)."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Final, final

import numpy as np

from twin._common.errors import InputError, closest_name
from twin._common.files import read_bytes
from twin.machine.machine import Machine
from twin.measurement.contacts import Contacts, Probing, SphereCentre, numbered_rounds, reduce_contacts
from twin.measurement.table import Measurements


@final
@dataclass(frozen=True)
class FormatSpecification:
    """Description of a format.

    Attributes:
        name: name that selects it.
        instrument: name of the instrument, in the table's column of that name.
        needs: what the file does not contain and the caller must give, in words.
        source: public description that it was written from.
        unverified: what no public description covers; listed with every conversion.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    gives: str
    instrument: str
    needs: str
    source: str
    unverified: tuple[str, ...]


@final
@dataclass(frozen=True)
class Given:
    """Data that a file of another program lacks; each format uses some of them.

    Attributes:
        at: positions of axes that the file does not contain, mm and degrees, by axis.
        offset: added to the coordinates of the file to give axis positions, by axis.
        axis: axis that was measured.
        contacts: number of consecutive contacts with each sphere; None: all in one pose.
        plan: commanded positions, row by row, of an export without them.
        trace: element of the file that holds the readings.
        start_deg, sweep_deg: angle of a circle's first reading, and the angle that it spans.
    """

    at: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    offset: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    axis: str | None = None
    probing: Probing = field(default_factory=Probing)
    contacts: int | None = None
    plan: Measurements | None = None
    trace: str | None = None
    start_deg: float = 0.0
    sweep_deg: float = 360.0

    def offsets(self, machine: Machine) -> np.ndarray:
        """Return (axes,) the offset of every axis, zero where none is given."""
        return np.array([self.offset.get(name, 0.0) for name in machine.names])

    def positions(self, machine: Machine, known: Sequence[str]) -> np.ndarray:
        """Return (axes,) the given positions; zero for axes that the file itself gives.

        Raises `InputError`: an axis is given neither by the file nor by the caller.
        """
        missing = [name for name in machine.names if name not in self.at and name not in known]
        if missing:
            raise InputError(
                f"the file does not contain the position of {', '.join(missing)}",
                expected="the position of every axis at which it was measured, mm and degrees",
                setting="at",
            )
        return np.array([self.at.get(name, 0.0) for name in machine.names])

    def check(self, machine: Machine) -> None:
        """Raise `InputError` for the name of an axis that the machine does not have."""
        for name in (*self.at, *self.offset, *([self.axis] if self.axis is not None else [])):
            if name not in machine.names:
                raise InputError(
                    "unknown axis",
                    expected=f"one of {', '.join(machine.names)}",
                    value=name,
                    nearest=closest_name(name, machine.names),
                )


@final
@dataclass(frozen=True)
class Conversion:
    """A measurement table made from a file of another program.

    ``notes``: assumptions (they begin with ``assumed``) and findings, one sentence each; ``centres``: sphere centres with their
    covariances, if the file has single contacts.
    """

    measurements: Measurements
    notes: tuple[str, ...] = ()
    centres: tuple[SphereCentre, ...] = ()

    def with_notes(self, *notes: str) -> Conversion:
        """Return the conversion with further notes."""
        return replace(self, notes=(*self.notes, *notes))


class MeasuredFormat(ABC):
    """One format of measured data."""

    specification: ClassVar[FormatSpecification]

    @property
    def name(self) -> str:
        """Name that selects the format."""
        return self.specification.name

    @abstractmethod
    def recognises(self, text: str) -> bool:
        """Return whether a text is a file of this format, by its content."""

    @abstractmethod
    def read(self, path: Path, machine: Machine, given: Given, round_name: str) -> Conversion:
        """Return the measurement table of one file.

        ``round_name``: name of the round, where the file has none.

        Raises `InputError`: with file, line, value and what was expected: the file is malformed, truncated, or has an element or a unit
        that is not known; something is missing in ``given``.
        """


@final
@dataclass(frozen=True)
class ContactRow:
    """One contact read from a file.

    ``positions``: positions by axis, mm and degrees; ``direction``: probing direction along X, Y, Z; NaN where unknown; ``round``: name
    of the round; None: from the order of the contacts.
    """

    line: int
    positions: Mapping[str, float]
    sphere: str = "sphere"
    direction: tuple[float, float, float] = (np.nan, np.nan, np.nan)
    round: str | None = None


def reduced(
    rows: Sequence[ContactRow], path: Path, machine: Machine, given: Given, *, simulated: bool = False
) -> Conversion:
    """Return the conversion of single contacts into sphere centres.

    ``rows``: the contacts, in the order in which they were made; ``given``: offsets, positions of axes that the file does not contain,
    radii and noise; ``simulated``: whether the contacts were simulated.

    Raises `InputError`: no contacts, an axis without a position, or as `reduce_contacts`.
    """
    if not rows:
        raise InputError("no contacts", expected="one or more contacts of a probe", file=path)
    base = given.positions(machine, tuple(rows[0].positions))
    positions = np.tile(base, (len(rows), 1))
    for column, name in enumerate(machine.names):
        if name in rows[0].positions:
            positions[:, column] = [row.positions[name] for row in rows]
            positions[:, column] += given.offset.get(name, 0.0)
    sphere = np.array([row.sphere for row in rows], dtype=object)
    poses = np.delete(positions, list(machine.linear), axis=1)
    rounds: Any = numbered_rounds(sphere, poses, given.contacts)
    if rows[0].round is not None:
        rounds = np.array([row.round for row in rows], dtype=object)
    reduction = reduce_contacts(
        Contacts(
            source=str(path),
            lines=np.array([row.line for row in rows]),
            positions=positions,
            sphere=sphere,
            round=rounds,
            direction=np.array([row.direction for row in rows]),
            simulated=simulated,
        ),
        machine,
        given.probing,
    )
    return Conversion(reduction.measurements, reduction.notes, reduction.centres)


# --- Numbers, lines and texts of foreign files, read with file, line and value in every message ---

MAX_BYTES: Final = 2**26
"""Largest file of another program; a ball bar test has less than 1 MB."""
MAX_NUMBER: Final = 1e9
"""Largest absolute value of a number in any unit."""


def file_text(path: Path) -> str:
    """Return the text of a file; text that is not UTF-8 is read as Latin-1 (names and remarks in other programs' files).

    Raises `InputError`: it cannot be read, is larger than `MAX_BYTES`, or has NUL characters.
    """
    data = read_bytes(path, most_bytes=MAX_BYTES)
    if b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise InputError("not a text file", expected="text without NUL", file=path, line=line)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def file_lines(path: Path) -> list[tuple[int, str]]:
    """Return the lines of a file that are not blank, stripped, with their numbers. Raises `InputError`: as `file_text`."""
    text = file_text(path).replace("\r\n", "\n").replace("\r", "\n")
    return [(number, line.strip()) for number, line in enumerate(text.split("\n"), start=1) if line.strip()]


def number_in(text: str, what: str, path: Path, line: int) -> float:
    """Return a number with a decimal point. Raises `InputError`: it is not a number, not finite, or exceeds `MAX_NUMBER`."""
    try:
        value = float(text) if "_" not in text else math.nan
    except ValueError:
        value = math.nan
    if not abs(value) <= MAX_NUMBER:
        raise InputError(
            f"{what} is not a number", expected="a number with a decimal point", file=path, line=line, value=text
        )
    return value


def whole_number_in(text: str, what: str, path: Path, line: int, most: int) -> int:
    """Return a whole number from 1 to ``most``. Raises `InputError`: it is not one."""
    value = number_in(text, what, path, line)
    if value != int(value) or not 1 <= value <= most:
        raise InputError(
            f"{what} is not valid", expected=f"a whole number, 1 to {most}", file=path, line=line, value=text
        )
    return int(value)


def numbers_in(words: Sequence[str], what: str, path: Path, line: int) -> list[float]:
    """Return several numbers. Raises `InputError`: as `number_in`."""
    return [number_in(word, what, path, line) for word in words]


def code_in(text: str, known: Mapping[str, str], what: str, path: Path, line: int) -> str:
    """Return the meaning of a code. Raises `InputError`: it is unknown."""
    if text not in known:
        raise InputError(f"unknown {what}", expected=" or ".join(known), file=path, line=line, value=text)
    return known[text]
