"""What the words of the command line mean: options that are more than a path or a number, with errors that say what was expected."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from twin._common.errors import InputError, nearest
from twin.compensation.toolpath import Setup
from twin.compute.parallel import Tls, Workers
from twin.machine.conditions import Conditions
from twin.machine.control import FORMATS, ControlSection, TableEntry, read_tables
from twin.machine.iso16907 import NAMES
from twin.machine.machine import Machine
from twin.measurement.instruments import INSTRUMENTS, Air, Instrument
from twin.measurement.simulate import Surroundings
from twin.nc import find_program
from twin.samples import PLANS

MANY_WORDS: Final[Mapping[str, re.Pattern[str]]] = {
    "--work-offset": re.compile(r"[A-Za-z]\w*=.*"),
    "--at": re.compile(r"[A-Za-z]\w*=.*"),
    "--temperature": re.compile(r"[^\W\d][\w.-]*=.*"),
    "--scope": re.compile("|".join(re.escape(name) for name in NAMES), re.I),
    "--only": re.compile(r"E_[A-Z0-9*?]+"),
    "--reduce": re.compile(r"E_[A-Z0-9*?]+"),
}
"""Options that take several words (contract §3), and what every word after the first looks like."""
SMALLEST: Final = 1e-12
LARGEST: Final = 1e12
"""Of a number on the command line, whatever its unit: less than an atom, more than the seconds since 1970."""


def instrument_named(name: str) -> Instrument:
    """An instrument by its name.

    Raises:
        InputError: it is not; with what was expected.
    """
    for one in INSTRUMENTS:
        if one.name == name:
            return one
    known = [one.name for one in INSTRUMENTS]
    raise InputError(
        "no such instrument", expected=f"one of {', '.join(known)}", value=name, nearest=nearest(name, known)
    )


def plan_file(path: Path) -> Path:
    """A plan by its path, or one that comes with twin.

    Raises:
        InputError: it is not; with what was expected.
    """
    try:
        return find_program(path)  # looks for a file of any kind
    except InputError:
        known = [plan.name for plan in PLANS]
        raise InputError(
            "no such plan",
            expected=f"a measurement table, or one that comes with twin: {' '.join(known)}",
            file=path,
            nearest=nearest(path.name, known),
        ) from None


def tables_on(entries: Sequence[str], machine: Machine) -> ControlSection:
    """The control's tables that were on while a machine was measured, from ``FORMAT=FILE`` each.

    Raises:
        InputError: no such format; a file that cannot be read, or is no such table for this machine.
    """
    found: dict[str, list[Path]] = {}
    known = [form.name for form in FORMATS]
    for entry in entries:
        kind, equals, file = entry.partition("=")
        if not equals or kind not in known:
            raise InputError(
                "--control does not fit",
                expected=f"FORMAT=FILE, each file of the control once, FORMAT one of {', '.join(known)}",
                value=entry,
                nearest=nearest(kind, known),
            )
        found.setdefault(kind, []).append(Path(file))
    for kind, files in found.items():
        read_tables(kind, files, machine)
    return ControlSection(
        "remaining", tuple(TableEntry.of(file, kind, ()) for kind, files in found.items() for file in files)
    )


def surroundings(air: str | None, drift: list[str] | None) -> Surroundings:
    """Air and drift of a simulation.

    Raises:
        InputError: it is not; with what was expected.
    """
    rates: dict[str, tuple[float, float, float]] = {}
    for entry in drift or []:
        name, equals, text = entry.rpartition("=")
        if not equals or not name or name in rates:
            raise InputError("--drift does not fit", expected="STATION=x,y,z in µm/h, each station once", value=entry)
        rates[name] = three_numbers("--drift", text, entry, "x,y,z in µm/h")
    if air is None:
        return Surroundings(None, rates)
    temperature, pressure, humidity = three_numbers("--air", air, air, "T,p,RH in °C, hPa and %")
    return Surroundings(Air(temperature, pressure, humidity / 100.0), rates)


def three_numbers(option: str, text: str, shown: str, expected: str) -> tuple[float, float, float]:
    """Three numbers with commas between.

    Raises:
        InputError: it is not; with what was expected.
    """
    parts = text.split(",")
    if len(parts) != 3:
        raise InputError(f"{option} is not three numbers", expected=expected, value=shown)
    x, y, z = (number(option, part, shown) for part in parts)
    return x, y, z


def gathered(arguments: list[str]) -> list[str]:
    """Options that take several words (contract §3: ``--work-offset X=1 Y=2``, ``--scope L-POS L-STR``), one option a word."""
    patterns = MANY_WORDS
    out: list[str] = []
    gathering: str | None = None
    fresh = False
    for word in arguments:
        if word in patterns:
            gathering, fresh = word, True
        elif gathering and fresh:
            parts = [part for part in re.split(r"[\s,]+", word) if part] or [word]
            for part in parts:
                out += [gathering, part]
            fresh = False
        elif gathering and patterns[gathering].fullmatch(word):
            out += [gathering, word]
        else:
            gathering = None
            out.append(word)
    return [*out, gathering] if gathering and fresh else out


def setup(machine: Machine, offsets: list[str] | None, origin: str | None) -> Setup:
    """Offsets and origin of a program.

    Raises:
        InputError: it is not; with what was expected.
    """
    found = {}
    for entry in offsets or []:
        name, _, text = entry.partition("=")
        if name not in machine.by_name:
            raise InputError(
                "--work-offset of an unknown axis",
                expected=f"one of {', '.join(machine.names)}",
                value=entry,
                nearest=nearest(name, machine.names),
            )
        if name in found:
            raise InputError("--work-offset given twice", expected="each axis once", value=entry)
        found[name] = number("--work-offset", text, entry)
    place = (0.0, 0.0, 0.0)
    if origin is not None:
        parts = origin.split(",")
        if len(parts) != 3:
            raise InputError("--work-origin is not three numbers", expected="x,y,z in mm", value=origin)
        x, y, z = (number("--work-origin", part, origin) for part in parts)
        place = (x, y, z)
    return Setup(found, place)


def conditions(temperatures: list[str] | None, time_s: float | None) -> Conditions:
    """Temperatures and time of a program.

    Raises:
        InputError: it is not; with what was expected.
    """
    found = {}
    for entry in temperatures or []:
        name, equals, text = entry.partition("=")
        if not equals or not name:
            raise InputError("--temperature does not fit", expected="an axis or sensor and °C: X=23.1", value=entry)
        if name in found:
            raise InputError("--temperature given twice", expected="each axis or sensor once", value=entry)
        found[name] = number("--temperature", text, entry)
    return Conditions(found, time_s)


def workers(
    processes: int | None, scheduler: str | None, ca: Path | None, cert: Path | None, key: Path | None
) -> Workers:
    """Return who does the work.

    Raises:
        InputError: TLS files that are not complete, or without a scheduler that uses TLS.
    """
    if ca is None and cert is None and key is None:
        return Workers(processes, scheduler)
    if ca is None or cert is None:
        raise InputError(
            "TLS files that are not complete",
            expected="--tls-ca and --tls-cert, and --tls-key where the certificate's file holds no key",
        )
    return Workers(processes, scheduler, Tls(ca, cert, key))


def number(option: str, text: str, shown: str) -> float:
    """Return a number as `usable_number` wants it.

    Raises:
        InputError: it is not; with what was expected.
    """
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    usable_number(option, value, shown)
    return value


def usable_number(option: str, value: float, shown: object) -> None:
    """Raise `InputError` unless a number is finite and of a size that can be squared and divided by.

    Args:
        option: what it was given with.
        value: the number.
        shown: the text it was given as, for the message.

    Raises:
        InputError: it is not.
    """
    if not abs(value) < float("inf"):
        raise InputError(f"{option} is no number", expected="a finite number", value=shown)
    if value != 0.0 and not SMALLEST <= abs(value) <= LARGEST:
        raise InputError(
            f"{option} is beyond any machine",
            expected=f"0, or a number between {SMALLEST:g} and {LARGEST:g} in size",
            value=shown,
        )


def positive(option: str, value: float) -> None:
    """Nothing, if a value is a positive number.

    Raises:
        InputError: it is not; with what was expected.
    """
    if not 0.0 < value < float("inf"):
        raise InputError(f"{option} is out of place", expected="a positive number", value=value)
