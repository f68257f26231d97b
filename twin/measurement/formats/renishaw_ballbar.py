"""Circular tests of a Renishaw ball bar (QC10, QC20): files ``.b5r``, XML.

There is no public specification by Renishaw. The layout was learnt from programs in public repositories (found on GitHub by
``TEST_PLANE``, ``AF_CIRCULARITY`` and ``UT_LENGTH_UM``): one in C# and one in TypeScript that read results of such files, and a script
in Python that makes synthetic ones for the second. They agree on:

    <TEST_DOCUMENT>
      <TEST_SPEC NAME="…"><INSTRUMENT MODEL="QC10"><DYNAMIC_BALLBAR>
        <NOMINAL_LENGTH>50</NOMINAL_LENGTH><PROGRAMMED_FEEDRATE>1500</PROGRAMMED_FEEDRATE>
        <PLANE VIEW="+A+B" TEST_PLANE="XY"><A_AXIS_NAME>X</A_AXIS_NAME><B_AXIS_NAME>Y</B_AXIS_NAME></PLANE>
      </DYNAMIC_BALLBAR></INSTRUMENT></TEST_SPEC>
      <MACHINE_TESTED NAME="…"/>
      <RUN_RESULTS><BALLBAR_RUN><RUN_DIRECTION>CCW</RUN_DIRECTION>
        <FEATURE NAME="AF_CALCULATED_FEEDRATE" DT="UT_FEEDRATE">1498.2</FEATURE> …

and on the units ``DT``: ``UT_LENGTH_MM``, ``UT_LENGTH_UM``, ``UT_LENGTH_M``, ``UT_FEEDRATE`` (mm/min). **Where the readings of a run
are stored is described nowhere.** They are taken from the only element of a run that is a list of numbers with a ``DT`` of length, or
from the element that the caller names; everything that is assumed about them is listed with the conversion. The older ``.b5m`` and the
text export are not described publicly either, and are not read.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.xml_files import Element, parse_xml
from twin.machine.machine import Machine
from twin.measurement.formats.base import Conversion, FormatSpecification, Given, MeasuredFormat, file_text, number_in
from twin.measurement.table import Measurements

LENGTHS: Final[Mapping[str, float]] = {"UT_LENGTH_MM": 1.0, "UT_LENGTH_UM": 1e-3, "UT_LENGTH_M": 1e3}
"""Millimetres per unit."""
FEED: Final = "UT_FEEDRATE"
DIRECTIONS: Final[Mapping[str, float]] = {"CCW": 1.0, "CW": -1.0}
FEWEST: Final = 8
"""Least number of readings of a circle."""
MOST_DEVIATION_MM: Final = 5.0
"""Largest deviation from the nominal length that a ball bar can read; its sensors travel about 1 mm."""


@final
@dataclass(frozen=True)
class _Circle:
    """Axes, length and feed, common to all runs."""

    axes: tuple[str, str]
    length_mm: float
    feed_mm_min: float


@final
class RenishawBallbar(MeasuredFormat):
    """Circular tests of a Renishaw ball bar."""

    specification = FormatSpecification(
        name="renishaw-ballbar",
        title="Renishaw ball bar .b5r",
        suffixes=(".b5r",),
        gives="lengths of a ball bar on circles",
        instrument="ball-bar",
        needs="the centre of the circle, as positions of all axes",
        source="programs in public repositories that read or make such files; no specification by Renishaw is public",
        unverified=(
            "the element that holds the readings, their sign (longer is positive) and their spacing: equal steps of the angle",
            "the angle of the first reading: 0 is +A, counter-clockwise turns from +A to +B, and the run-in is left out",
            "NOMINAL_LENGTH in mm and PROGRAMMED_FEEDRATE in mm/min",
            "that nothing else in the file changes the readings (scaling to the calibrated length, temperature)",
        ),
    )

    def recognises(self, text: str) -> bool:
        """See `MeasuredFormat.recognises`."""
        return "<BALLBAR_RUN" in text or "<DYNAMIC_BALLBAR" in text

    def read(self, path: Path, machine: Machine, given: Given, round_name: str) -> Conversion:
        """See `MeasuredFormat.read`."""
        root = parse_xml(file_text(path), path, "a ball bar test as XML")
        if root.name != "TEST_DOCUMENT":
            raise InputError("unknown element", expected="<TEST_DOCUMENT>", file=path, line=root.line, value=root.name)
        circle = _circle(root, machine, path)
        centre = given.positions(machine, ())
        results = _only(root, "RUN_RESULTS", path)
        runs = results.each("BALLBAR_RUN")
        if not runs:
            raise InputError("no run", expected="<BALLBAR_RUN>", file=path, line=results.line)
        traces = [_trace(run, given.trace, path) for run in runs]
        tables, notes = [], set()
        for k, (run, trace) in enumerate(zip(runs, traces, strict=True), start=1):
            table, note = _run(run, trace, k, circle, centre + given.offsets(machine), path, machine, given)
            tables.append(table)
            notes.add(note)
        names = sorted({trace.attributes.get("NAME", trace.name) for trace in traces})
        named = "as named" if given.trace is not None else "the only list of lengths in each run"
        return Conversion(
            Measurements.join(tables),
            (
                f"assumed: the readings are in {', '.join(names)}, {named}",
                f"assumed: first reading at {given.start_deg:g}° from +{circle.axes[0]}, last after {given.sweep_deg:g}°, equal steps",
                *sorted(notes),
            ),
        )


def _circle(root: Element, machine: Machine, path: Path) -> _Circle:
    """Return axes, length and feed of the test."""
    spec = _only(root, "DYNAMIC_BALLBAR", path)
    plane = _only(spec, "PLANE", path)
    view = plane.attributes.get("VIEW", "")
    if view != "+A+B":
        raise InputError("unknown VIEW of the plane", expected="+A+B", file=path, line=plane.line, value=view)
    names = []
    for tag in ("A_AXIS_NAME", "B_AXIS_NAME"):
        element = _only(plane, tag, path)
        linear = [machine.axes[i].name for i in machine.linear]
        if element.text not in linear:
            expected = f"a linear axis of the machine: {', '.join(linear)}"
            raise InputError(
                f"unknown axis in {tag}", expected=expected, file=path, line=element.line, value=element.text
            )
        names.append(element.text)
    tested = plane.attributes.get("TEST_PLANE", "")
    if sorted(tested) != sorted(names):
        raise InputError(
            "TEST_PLANE does not fit the axes", expected="".join(names), file=path, line=plane.line, value=tested
        )
    length, feed = (_only(spec, tag, path) for tag in ("NOMINAL_LENGTH", "PROGRAMMED_FEEDRATE"))
    values = [number_in(element.text, element.name, path, element.line) for element in (length, feed)]
    for value, element in zip(values, (length, feed), strict=True):
        if value <= 0.0:
            raise InputError(
                f"{element.name} is not positive",
                expected="mm, mm/min",
                file=path,
                line=element.line,
                value=element.text,
            )
    return _Circle((names[0], names[1]), values[0], values[1])


def _only(element: Element, name: str, path: Path) -> Element:
    """Return the only element of that name below another one."""
    elements = [one for one in element.within() if one.name == name]
    if len(elements) != 1:
        raise InputError(f"{len(elements)} <{name}>", expected=f"one <{name}>", file=path, line=element.line)
    return elements[0]


def _values(element: Element) -> list[str]:
    """Return the numbers that an element lists, in its text or in children of one tag."""
    words = re.split(r"[\s,;]+", element.text) if element.text else [child.text for child in element.children]
    same = len({child.name for child in element.children}) <= 1
    return words if same and len(words) >= FEWEST and all(map(_is_number, words)) else []


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _trace(run: Element, named: str | None, path: Path) -> Element:
    """Return the element of a run that holds its readings."""
    lists = [one for one in run.within() if _values(one)]
    fitting = [
        one
        for one in lists
        if (
            named in (one.name, one.attributes.get("NAME"))
            if named is not None
            else one.attributes.get("DT") in LENGTHS
        )
    ]
    if len(fitting) != 1:
        names = ", ".join(
            f"{one.attributes.get('NAME', one.name)} ({len(_values(one))} numbers, DT {one.attributes.get('DT', 'missing')})"
            for one in lists
        )
        what = f"{len(fitting)} lists of lengths" if named is None else f"{len(fitting)} lists of the name {named}"
        raise InputError(
            f"{what} in a run",
            expected="one; the lists of numbers are: " + (names or "none; the file holds results without readings"),
            file=path,
            line=run.line,
            setting="trace",
        )
    (trace,) = fitting
    if trace.attributes.get("DT") not in LENGTHS:
        raise InputError(
            "unknown unit of the readings",
            expected=f'DT="{" or ".join(LENGTHS)}"',
            file=path,
            line=trace.line,
            value=trace.attributes.get("DT", "none"),
        )
    return trace


def _run(
    run: Element,
    trace: Element,
    number: int,
    circle: _Circle,
    centre: np.ndarray,
    path: Path,
    machine: Machine,
    given: Given,
) -> tuple[Measurements, str]:
    """Return the rows of one run, and a note on what its readings are counted from."""
    direction = _only(run, "RUN_DIRECTION", path)
    if direction.text not in DIRECTIONS:
        expected = " or ".join(DIRECTIONS)
        raise InputError("unknown direction", expected=expected, file=path, line=direction.line, value=direction.text)
    readings = np.array([float(word) for word in _values(trace)]) * LENGTHS[trace.attributes["DT"]]
    absolute = bool(np.median(readings) > circle.length_mm / 2.0)
    lengths = readings if absolute else circle.length_mm + readings
    if np.abs(lengths - circle.length_mm).max() > MOST_DEVIATION_MM:
        raise InputError(
            "a reading is outside the travel of a ball bar",
            expected=f"within {MOST_DEVIATION_MM:g} mm of the nominal length {circle.length_mm:g} mm",
            file=path,
            line=trace.line,
            value=f"{lengths[np.argmax(np.abs(lengths - circle.length_mm))]:g} mm",
        )
    n, turn = len(readings), DIRECTIONS[direction.text]
    angle = np.radians(given.start_deg + turn * given.sweep_deg * np.arange(n) / (n - 1))
    positions, approach = np.tile(centre, (n, 1)), np.zeros((n, len(machine.axes)))
    for name, place, motion in zip(
        circle.axes, (np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle)), strict=True
    ):
        column = machine.names.index(name)
        positions[:, column] += circle.length_mm * place
        approach[:, column] = np.where(np.abs(motion) > 1e-9, np.sign(turn * motion), 0.0)
    point = np.full((n, 3), np.nan)
    point[:, 0] = lengths

    def words(word: str) -> np.ndarray:
        return read_only(np.full(n, word, dtype=object))

    table = Measurements(
        source=str(path),
        lines=read_only(np.full(n, trace.line)),
        positions=read_only(np.round(positions, 9)),
        target=words("ball"),
        carrier=words("tool"),
        station=words("pivot"),
        station_carrier=words("work"),
        round=words(str(number)),
        point_mm=read_only(point),
        approach=read_only(approach),
        feed_mm_min=read_only(np.full(n, _feed(run, circle, path))),
        bar_mm=read_only(np.full(n, circle.length_mm)),
    )
    counted = "the length itself" if absolute else f"deviations from the nominal length {circle.length_mm:g} mm"
    return table, f"assumed: the readings are {counted}"


def _feed(run: Element, circle: _Circle, path: Path) -> float:
    """Return the feed that was measured, or the programmed one."""
    features = [one for one in run.each("FEATURE") if one.attributes.get("NAME") == "AF_CALCULATED_FEEDRATE"]
    if not features:
        return circle.feed_mm_min
    if features[0].attributes.get("DT") != FEED:
        unit = features[0].attributes.get("DT", "none")
        raise InputError("unknown unit of the feed", expected=FEED, file=path, line=features[0].line, value=unit)
    return number_in(features[0].text, "the feed", path, features[0].line)
