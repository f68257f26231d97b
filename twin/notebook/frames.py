"""Calibrations and measurement tables as pandas frames, and back."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from twin._common.errors import InputError
from twin._common.files import scratch_folder
from twin.machine.calibration import Calibration
from twin.machine.effects import split_name
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.notebook.optional import optional

if TYPE_CHECKING:
    import pandas as pd

COLUMNS: Final = ("error", "kind", "term", "value", "unit", "u")
_TEXT: Final = ("target", "carrier", "station", "station_carrier")
_COMMENTS: Final = "comments"


def to_frame(what: Calibration | Measurements, machine: Machine | None = None) -> pd.DataFrame:
    """Return a calibration or a measurement table as a pandas frame.

    Of a calibration: one row per number with the columns ``error`` (``E_XX``), ``kind`` (``curve``, ``squareness``, ``location``),
    ``term`` (index of a curve's coefficient, else 0), ``value``, ``unit`` and ``u``, the standard uncertainty (NaN if unknown). The
    covariance between rows, domains and bases of the curves, and effects that a diagnosis added are not in the frame;
    `calibration_from_frame` takes them from a calibration.

    Of a table: the columns of its CSV file; the file's comments are in ``attrs``.

    Args:
        what: calibration or table.
        machine: the table's machine; not needed for a calibration.

    Raises:
        InputError: pandas is not installed; a table without its machine.
    """
    pandas = optional("pandas")
    if isinstance(what, Calibration):
        frame = pandas.DataFrame(_rows(what), columns=list(COLUMNS))
        frame.attrs["source"] = what.source
        frame.attrs["warnings"] = [warning.title for warning in what.warnings]
        return frame
    if machine is None:
        raise InputError("a measurement table needs its machine", expected="to_frame(table, machine)")
    text = what.to_csv(machine)
    lines = text.splitlines()
    comments = [line for line in lines if line.startswith("#")]
    body = "\n".join(line for line in lines if not line.startswith("#"))
    frame = pandas.read_csv(
        io.StringIO(body),
        dtype=dict.fromkeys(_TEXT, str),
        float_precision="round_trip",
        keep_default_na=False,
        na_values=[""],
    )
    frame.attrs[_COMMENTS] = comments
    return frame


def calibration_from_frame(frame: pd.DataFrame, calibration: Calibration) -> Calibration:
    """Return a calibration with the values of a frame; an unchanged frame gives the same calibration.

    The covariance, the domains and bases of the curves, effects and tables of the control are those of ``calibration``. Values of a
    unit other than that of the calibration are not converted.

    Args:
        frame: as `to_frame` returns it; rows in any order, every number of the calibration once.
        calibration: the calibration that the frame was made from, or one with the same numbers.

    Raises:
        InputError: a column or a row is missing, given twice, or unknown, or a value is not finite; the error names it.
    """
    missing = [name for name in ("error", "term", "value") if name not in frame.columns]
    if missing:
        raise InputError("missing column", expected=", ".join(COLUMNS), value=missing[0])
    values: dict[tuple[str, int], float] = {}
    for error, term, value in zip(frame["error"], frame["term"], frame["value"], strict=True):
        key = str(error), int(term)
        if key in values or not np.isfinite(value):
            what = "row given twice" if key in values else "value is not a number"
            raise InputError(what, expected="one finite value for each number", value=f"{key[0]}[{key[1]}] {value}")
        values[key] = float(value)
    known = {(row[0], row[2]) for row in _rows(calibration)}
    for wrong, what in ((known - set(values), "missing row"), (set(values) - known, "unknown row")):
        if wrong:
            name, term = min(wrong)
            raise InputError(what, expected="the rows of to_frame(calibration)", value=f"{name}[{term}]")
    curves = {
        name: replace(curve, coefficients=tuple(values[name, k] for k in range(len(curve.coefficients))))
        for name, curve in calibration.curves.items()
    }
    return replace(
        calibration,
        curves=MappingProxyType(curves),
        squareness=MappingProxyType({name: values[name, 0] for name in calibration.squareness}),
        location=MappingProxyType({name: values[name, 0] for name in calibration.location}),
    )


def measurements_from_frame(frame: pd.DataFrame, machine: Machine) -> Measurements:
    """Return a measurement table from a frame with the columns of its CSV file (`twin doc files`).

    Args:
        frame: the rows; comments in ``attrs``, as `to_frame` puts them there, say where the numbers come from (``simulated``).
        machine: the machine.

    Raises:
        InputError: as for `Measurements.load`; the line is that of the frame written as CSV.
    """
    text = frame.to_csv(index=False, lineterminator="\n")
    comments = "".join(f"{line}\n" for line in frame.attrs.get(_COMMENTS, ()))
    with scratch_folder() as folder:
        path = folder / "frame.csv"
        path.write_text(comments + text, encoding="utf-8")
        try:
            return replace(Measurements.load(path, machine), source="frame")
        except InputError as error:
            raise InputError(
                error.what, expected=error.expected, file="frame", line=error.line, value=error.value
            ) from None


def _rows(calibration: Calibration) -> list[tuple[Any, ...]]:
    """Return the rows of a calibration's frame."""
    covariance = calibration.covariance
    variance = dict(zip(covariance.names, np.diagonal(covariance.matrix), strict=True))

    def u(*names: str) -> float:
        return next((float(np.sqrt(variance[name])) for name in names if name in variance), float("nan"))

    rows: list[tuple[Any, ...]] = []
    for name, curve in calibration.curves.items():
        for k, value in enumerate(curve.coefficients):
            rows.append((name, "curve", k, float(value), curve.unit, u(f"{name}[{k}]")))
    constants: tuple[tuple[str, Mapping[str, float]], ...] = (
        ("squareness", calibration.squareness),
        ("location", calibration.location),
    )
    for kind, found in constants:
        for name, value in found.items():
            unit = "urad" if kind == "squareness" or split_name(name)[0] >= 3 else "um"
            rows.append((name, kind, 0, float(value), unit, u(name)))
    return rows
