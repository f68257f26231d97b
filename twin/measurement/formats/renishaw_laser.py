"""Linear positioning runs of a Renishaw laser interferometer (XL-80, ML10) as its software saves them: ``.rtl``, ``.rtx``.

There is no public specification by Renishaw. The layout was learnt from programs in public repositories that read or write such files
(found on GitHub by the texts ``Run Target Data:`` and ``TARGET DATA::``): a program in Java that makes tables for Heidenhain and
Siemens controls, with values of a real file in its comments; three in C# and C++ for controls and for interferometers of other makers;
one in JavaScript. They agree on:

- sections ``HEADER::``, ``TARGET DATA::``, ``USER-TEXT::``, ``RUNS::``, ``DEVIATIONS::``, ``ENVIRONMENT::``, ``EQUIPMENT::``,
``EOF::``;
- targets in mm, ``Target-count`` of them; ``Run-count`` runs; one line ``run target deviation`` for each reading, deviation in µm,
  measured less target; every second run goes through the targets in reverse;
- numbers with decimal points, or with decimal commas throughout (programs that use the language of Windows);
- ``Air temp`` and ``Mat temp 1`` … ``3``: at the start and at the end, then a code of the unit (0 with values in °C); −10 where no
  sensor is connected.

A file ``.rtx`` may also be a dynamic capture (repository TanmayPani/rtx2csv): samples over time without targets, which is refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.files import read_bytes
from twin.machine.machine import Machine
from twin.measurement.formats.base import (
    MAX_BYTES,
    Conversion,
    FormatSpecification,
    Given,
    MeasuredFormat,
    code_in,
    file_lines,
    number_in,
    numbers_in,
    whole_number_in,
)
from twin.measurement.table import Measurements

SECTION: Final = re.compile(r"([A-Z][A-Z -]*)::")
SECTIONS: Final = ("HEADER", "TARGET DATA", "USER-TEXT", "RUNS", "DEVIATIONS", "ENVIRONMENT", "EQUIPMENT", "EOF")
KNOWN: Final[Mapping[str, tuple[str, ...]]] = {
    "HEADER": ("File type", "File Type", "Owner", "Version no"),
    "TARGET DATA": ("Filetype", "Target-count", "Targets", "Flags"),
    "RUNS": ("Run-count",),
    "DEVIATIONS": ("Run Target Data",),
}
"""Entries of the sections that the reading depends on; others there are refused."""
TEMPERATURES: Final = {"Air temp": "air", **{f"Mat temp {k}": f"material_{k}" for k in (1, 2, 3)}}
NO_SENSOR: Final = -10.0
UNITS: Final = {"0": "degC"}
LISTS: Final = ("Targets", "Run Target Data")
"""Entries with numbers on the lines below."""
_NUMBERS: Final = re.compile(r"[-+\d.,\s]+")
MOST: Final = 100_000
"""Largest number of targets and of runs."""


@final
@dataclass
class _File:
    """The parts of a file while it is read."""

    entries: dict[tuple[str, str], tuple[int, str]] = field(default_factory=dict)
    targets: list[float] = field(default_factory=list)
    readings: list[tuple[int, int, int, float]] = field(default_factory=list)
    last: int = 1


@final
class RenishawLaser(MeasuredFormat):
    """Linear positioning runs of a Renishaw laser interferometer."""

    specification = FormatSpecification(
        name="renishaw-laser",
        title="Renishaw laser, linear positioning runs",
        suffixes=(".rtl", ".rtx"),
        gives="lengths along the beam",
        instrument="linear-interferometer",
        needs="positions of the other axes; the axis, if the file's Axis is not its name",
        source="programs in public repositories that read and write such files; no specification by Renishaw is public",
        unverified=(
            "deviations in um and measured less target: three programs agree, no specification",
            "the four Flags of the target data, which are not interpreted",
            "the code 0 of the unit of temperatures as degC, and -10 as no sensor",
            "whether the deviations are already normalised to 20 degC by the material compensation of the software",
        ),
    )

    def recognises(self, text: str) -> bool:
        """See `MeasuredFormat.recognises`."""
        return text.lstrip().startswith("HEADER::")

    def read(self, path: Path, machine: Machine, given: Given, round_name: str) -> Conversion:
        """See `MeasuredFormat.read`."""
        head = read_bytes(path, most_bytes=MAX_BYTES)[:8192]
        if b"Data:" in head and b"TARGET DATA::" not in head:
            raise InputError(
                "a dynamic capture: samples over time without targets", expected="a linear positioning run", file=path
            )
        parts = _parsed(path)
        kind = parts.entries.get(("HEADER", "File type"), parts.entries.get(("HEADER", "File Type"), (1, "")))
        if kind[1].lower() not in ("rtl", "rtx"):
            expected = "rtl: a linear measurement (rta is angular, in other units)"
            raise InputError("unknown File type", expected=expected, file=path, line=kind[0], value=kind[1])
        runs = _check_complete(parts, path)
        axis, how = _axis(parts, machine, given, path)
        return _converted(parts, runs, axis, path, machine, given).with_notes(
            how,
            "assumed: the beam is along the axis, and the length grows with its position",
            "assumed: all readings of a run are approached in the direction of the run",
        )


def _parsed(path: Path) -> _File:
    """Return the entries, targets and readings of a file."""
    parts, section, list_of, lines = _File(), "", "", file_lines(path)
    commas = _has_decimal_commas(text for _, text in lines)
    for line, text in lines:
        parts.last = line
        heading = SECTION.fullmatch(text)
        if heading is not None:
            section, list_of = heading[1].strip(), ""
            if section not in SECTIONS:
                raise InputError("unknown section", expected=", ".join(SECTIONS), file=path, line=line, value=text)
            continue
        label, colon, rest = text.partition(":")
        if colon and section != "" and text[0].isalpha():
            name = label.strip()
            rest = _pointed(rest) if commas and (section == "ENVIRONMENT" or name in LISTS) else rest
            if section in KNOWN and name not in KNOWN[section]:
                raise InputError(
                    f"unknown entry of {section}", expected=", ".join(KNOWN[section]), file=path, line=line, value=text
                )
            parts.entries[section, name] = (line, rest.strip())
            list_of = name if name in LISTS else ""
            words = rest.split() if list_of else []
        else:
            words = (_pointed(text) if commas and list_of else text).split()
        if section in ("", "EOF") and words:
            raise InputError("text outside the sections", expected="HEADER::", file=path, line=line, value=text)
        if list_of == "Targets":
            parts.targets += numbers_in(words, "a target", path, line)
        elif list_of == "Run Target Data" and words:
            parts.readings.append(_reading(words, path, line))
        elif section in KNOWN and not colon:
            raise InputError(f"unknown text in {section}", expected="NAME: value", file=path, line=line, value=text)
    return parts


def _has_decimal_commas(lines: Iterable[str]) -> bool:
    """Return whether the numbers of a file have decimal commas, as programs in such a language write them, and none has a point."""
    numbers = [word for line in lines if _NUMBERS.fullmatch(line) for word in line.split()]
    return any("," in word for word in numbers) and not any("." in word for word in numbers)


def _pointed(text: str) -> str:
    return re.sub(r"(?<=\d),(?=\d)", ".", text)


def _reading(words: list[str], path: Path, line: int) -> tuple[int, int, int, float]:
    if len(words) != 3:
        expected = "run, target and deviation"
        raise InputError("not a reading", expected=expected, file=path, line=line, value=" ".join(words))
    run, target = (whole_number_in(word, "run or target", path, line, MOST) for word in words[:2])
    return line, run, target, number_in(words[2], "a deviation", path, line)


def _check_complete(parts: _File, path: Path) -> list[np.ndarray]:
    """Return the readings' indices of every run, in the order of the file.

    Raises `InputError`: a count that is missing or not met, a target given twice in a run, a run that goes back and forth.
    """
    counts = {}
    for section, name, found in (
        ("TARGET DATA", "Target-count", len(parts.targets)),
        ("RUNS", "Run-count", len({run for _, run, _, _ in parts.readings})),
    ):
        line, text = parts.entries.get((section, name), (parts.last, ""))
        counts[name] = whole_number_in(text, name, path, line, MOST)
        if counts[name] != found:
            what = "targets" if name == "Target-count" else "runs"
            raise InputError(f"{found} {what}", expected=f"{counts[name]}, as {name} states", file=path, line=line)
    runs = []
    for run in range(1, counts["Run-count"] + 1):
        rows = np.array([i for i, reading in enumerate(parts.readings) if reading[1] == run], dtype=int)
        visited = [parts.readings[i][2] for i in rows]
        line = parts.readings[rows[-1]][0] if len(rows) else parts.last
        if sorted(visited) != list(range(1, counts["Target-count"] + 1)):
            raise InputError(
                f"run {run} has not every target once",
                expected=f"targets 1 to {counts['Target-count']}",
                file=path,
                line=line,
            )
        steps = np.sign(np.diff(np.array(parts.targets)[np.array(visited) - 1]))
        if len(set(steps.tolist())) > 1 or 0.0 in steps:
            raise InputError(
                f"run {run} goes back and forth", expected="targets in one direction", file=path, line=line
            )
        runs.append(rows)
    zero = [all(parts.readings[i][3] == 0.0 for i in rows) for rows in runs]
    if any(zero) and not all(zero):
        run = zero.index(True)
        raise InputError(
            f"run {run + 1} reads zero at every target",
            expected="a measured run; programs fill the way back of a unidirectional test with zeros: remove such runs",
            file=path,
            line=parts.readings[runs[run][0]][0],
        )
    return runs


def _axis(parts: _File, machine: Machine, given: Given, path: Path) -> tuple[str, str]:
    """Return the axis and a note on where its name comes from."""
    linear = [machine.axes[i].name for i in machine.linear]
    line, text = parts.entries.get(("USER-TEXT", "Axis"), (parts.last, ""))
    name, how = (given.axis, "as given") if given.axis is not None else (text, "from the file's Axis")
    if name not in linear:
        raise InputError(
            "the measured axis is not known",
            expected=f"one of the linear axes {', '.join(linear)}",
            file=path,
            line=line,
            value=name,
            setting=None if given.axis is not None else "axis",
        )
    return name, f"axis {name}, {how}"


def _converted(
    parts: _File, runs: list[np.ndarray], axis: str, path: Path, machine: Machine, given: Given
) -> Conversion:
    order = np.concatenate(runs)
    lines, run, target, deviation = (np.array(column)[order] for column in zip(*parts.readings, strict=True))
    n, column = len(order), machine.names.index(axis)
    at = np.array(parts.targets)[target.astype(int) - 1]
    positions = np.tile(given.positions(machine, (axis,)), (n, 1))
    positions[:, column] = at + given.offset.get(axis, 0.0)
    approach = np.zeros((n, len(machine.axes)))
    for rows in runs:
        visited = np.isin(order, rows)
        if len(rows) > 1:
            approach[visited, column] = np.sign(np.diff(at[visited])[0])
    temperatures, notes = _temperatures(parts, path, n)
    point = np.full((n, 3), np.nan)
    point[:, 0] = at + deviation * 1e-3
    return Conversion(
        Measurements(
            source=str(path),
            lines=read_only(lines.astype(int)),
            positions=read_only(positions),
            target=read_only(np.full(n, "reflector", dtype=object)),
            carrier=read_only(np.full(n, "tool", dtype=object)),
            station=read_only(np.full(n, f"laser {axis}", dtype=object)),
            round=read_only(np.array([str(int(k)) for k in run], dtype=object)),
            point_mm=read_only(point),
            approach=read_only(approach),
            temperature_degC=MappingProxyType(temperatures),
        ),
        notes,
    )


def _temperatures(parts: _File, path: Path, n: int) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Return the temperatures by sensor, the mean of start and end, and notes on entries that are not used."""
    temperatures, notes = {}, []
    for (section, name), (line, text) in parts.entries.items():
        if section != "ENVIRONMENT" or name not in TEMPERATURES:
            continue
        words = text.split()
        if not words:
            continue
        if len(words) != 3:
            expected = "at the start, at the end, code of the unit"
            raise InputError(f"{name} is not complete", expected=expected, file=path, line=line, value=text)
        start, end = numbers_in(words[:2], name, path, line)
        code_in(words[2], UNITS, f"unit of {name}", path, line)
        if start == end == NO_SENSOR:
            notes.append(f"{name}: {NO_SENSOR:g} at the start and at the end, assumed to mean no sensor")
            continue
        temperatures[TEMPERATURES[name]] = read_only(np.full(n, round((start + end) / 2.0, 6)))
    if temperatures:
        notes.append("temperatures are the means of start and end")
    return temperatures, tuple(notes)
