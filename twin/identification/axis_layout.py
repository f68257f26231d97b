"""A table of a multi-axis interferometer's readings: one row for each position of the axis, one column for each beam.

Columns ``<axis>_mm`` (commanded) and ``beam_<name>_mm`` for every beam of the layout, optionally ``round``, ``approach`` and
``time_s``; an empty cell is a beam that was not read. Rows that cannot be used are listed in `BeamReadings.set_aside` with line and
reason.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal, final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from twin._common.arrays import read_only
from twin._common.csv_tables import Cells, read_table, unused_column_note
from twin._common.errors import InputError
from twin._common.files import write_atomic
from twin._common.messages import Message
from twin._common.units import MM, UM, URAD
from twin._common.yaml_files import EntryPath, line_of, load_yaml
from twin.machine.machine import Axis, Machine
from twin.measurement.columns import (
    LARGEST_MM,
    RowNote,
    comment_lines,
    csv_text,
    number_cells,
    outside_axis_range,
    printed,
    refuse_contacts,
    simulated_comments,
)
from twin.measurement.instruments.multi_axis import MultiAxis
from twin.model.calibration import Calibration
from twin.model.effects import assemble
from twin.numerics.spatial import rotation_exp, rotation_log

SCHEMA: Final = "twin.interferometer/1"
PPM: Final = 1e-6

_Vector = tuple[float, float, float]
_Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_]*$")]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _MirrorEntry(_Strict):
    normal: _Vector
    distance_mm: float


class _BeamEntry(_Strict):
    mirror: str
    source_mm: _Vector
    direction: _Vector


class _Uncertainty(_Strict):
    noise_um: Annotated[float, Field(gt=0)]
    position_um: Annotated[float, Field(ge=0)]
    angle_urad: Annotated[float, Field(ge=0)]
    mirror_urad: Annotated[float, Field(ge=0)]
    scale_ppm: Annotated[float, Field(ge=0)] = 0.0

    def of(self, installation: Sequence[str]) -> np.ndarray:
        """Return (p,) the standard uncertainties of an installation's parameters, by their names; metres, radians, one."""
        angles = {"beam": self.angle_urad, "mirror": self.mirror_urad}
        return read_only(
            np.array(
                [
                    self.scale_ppm * PPM
                    if name == "scale"
                    else angles[name.split()[0]] * URAD
                    if " turn " in name
                    else self.position_um * UM
                    for name in installation
                ]
            )
        )


class _LayoutFile(_Strict):
    schema_: Literal["twin.interferometer/1"] = Field(alias="schema")
    name: str
    axis: str
    reference_mm: float
    place_mm: _Vector
    reading: Literal["path", "displacement"] = "path"
    mirrors: Annotated[dict[_Name, _MirrorEntry], Field(min_length=1)]
    beams: Annotated[dict[_Name, _BeamEntry], Field(min_length=6)]
    uncertainty: _Uncertainty


@final
@dataclass(frozen=True)
class AxisLayout:
    """A multi-axis interferometer on one linear axis; lengths in metres, angles in radians.

    Its coordinates are along the axes of that axis's error frame; its origin is a point of the carriage at the reference position. The
    interferometer is at rest, the mirrors move.

    Attributes:
        reference_mm: commanded position at which the counters were set to zero.
        place: (3,) the carriage's point, from the origin of the axis's error frame.
        halved: whether a reading is half the change of path.
        installation_u: (p,) standard uncertainties in the order of `MultiAxis.installation`.
    """

    name: str
    axis: Axis
    beams: MultiAxis
    reference_mm: float
    place: np.ndarray
    halved: bool
    noise: float
    installation_u: np.ndarray
    path: Path | None = None

    @classmethod
    def load(cls, path: str | Path, machine: Machine) -> AxisLayout:
        """Read and check a layout file. Raises `InputError`: with file, line, value and what was expected."""
        path = Path(path)
        entries, lines = load_yaml(path, _LayoutFile, SCHEMA)
        check = _Entries(path, lines)
        linear = [axis.name for axis in machine.axes if axis.linear]
        if entries.axis not in linear:
            raise check.fail(("axis",), "not a linear axis of this machine", " or ".join(linear), entries.axis)
        axis = machine.by_name[entries.axis]
        lower, upper = axis.lower, axis.upper
        if lower is not None and upper is not None and not lower <= entries.reference_mm <= upper:
            raise check.fail(
                ("reference_mm",), "outside the axis's range", f"{lower:g} to {upper:g} mm", entries.reference_mm
            )
        mirrors = tuple(entries.mirrors)
        for name, beam in entries.beams.items():
            if beam.mirror not in mirrors:
                raise check.fail(("beams", name, "mirror"), "unknown mirror", " or ".join(mirrors), beam.mirror)
        normals = [check.unit(("mirrors", name, "normal"), one.normal) for name, one in entries.mirrors.items()]
        directions = [check.unit(("beams", name, "direction"), one.direction) for name, one in entries.beams.items()]
        try:
            beams = MultiAxis(
                beams=tuple(entries.beams),
                source=read_only(np.array([one.source_mm for one in entries.beams.values()]) * MM),
                direction=read_only(np.array(directions)),
                mirror=read_only(np.array([mirrors.index(one.mirror) for one in entries.beams.values()])),
                mirrors=mirrors,
                normal=read_only(np.array(normals)),
                distance=read_only(np.array([mirror.distance_mm for mirror in entries.mirrors.values()]) * MM),
                planar=False,
            )
        except InputError as error:
            names = [name for name in entries.beams if error.what.startswith(f"beam {name} ")]
            place: EntryPath = ("beams", names[0]) if names else ("beams",)
            raise check.fail(place, error.what, error.expected, error.value) from None
        halved = entries.reading == "displacement"
        return cls(
            name=entries.name,
            axis=axis,
            beams=beams,
            reference_mm=entries.reference_mm,
            place=read_only(np.array(entries.place_mm) * MM),
            halved=halved,
            noise=entries.uncertainty.noise_um * UM * (2.0 if halved else 1.0),
            installation_u=entries.uncertainty.of(beams.installation),
            path=path,
        )

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of a table of its readings."""
        return self.beams.specification.columns

    def travel(self, positions_mm: np.ndarray) -> np.ndarray:
        """Return (n, 3) the nominal travel from the reference position, metres."""
        return (positions_mm - self.reference_mm)[:, None] * MM * np.array(self.axis.direction)


@final
@dataclass(frozen=True)
class _Entries:
    path: Path
    lines: Mapping[EntryPath, int]

    def fail(self, place: EntryPath, what: str, expected: str, value: object) -> InputError:
        return InputError(
            f"`{'.'.join(str(part) for part in place)}`: {what}",
            expected=expected,
            file=self.path,
            line=line_of(place, self.lines),
            value=value,
        )

    def unit(self, place: EntryPath, vector: _Vector) -> np.ndarray:
        length = float(np.linalg.norm(vector))
        if length == 0.0:
            raise self.fail(place, "the vector is zero", "a vector that is not zero", list(vector))
        return np.array(vector) / length


# --- A table of a multi-axis interferometer's readings: one row for each position of the axis, one column for each beam

FEWEST_BEAMS: Final = 6
"""Least number of beams that determine six motions."""


@final
@dataclass(frozen=True)
class BeamReadings:
    """Readings of n rows; arrays are read-only.

    Attributes:
        source: the file, or another description of the source.
        lines: (n,) line of each row in the file.
        position_mm: (n,) commanded.
        change_mm: (n, m) as displayed by the instrument; NaN for a beam that was not read.
        round: (n,) names.
        approach: (n,) +1, −1, 0 unknown.
        time_s: (n,) NaN where not given.
        set_aside: rows of the file that are not used, and why.
        simulated: whether they were simulated, not measured on a machine.
    """

    source: str
    lines: np.ndarray
    position_mm: np.ndarray
    change_mm: np.ndarray
    round: np.ndarray
    approach: np.ndarray
    time_s: np.ndarray
    set_aside: tuple[RowNote, ...] = ()
    notices: tuple[Message, ...] = ()
    simulated: bool = False

    def __len__(self) -> int:
        return len(self.lines)

    def paths(self, layout: AxisLayout) -> np.ndarray:
        """Return (n, m) the change of path, there and back, metres."""
        return np.asarray(self.change_mm * MM * (2.0 if layout.halved else 1.0))

    def to_csv(self, layout: AxisLayout, *, comment: str = "") -> str:
        """Return the table as text, which reads back as the same readings; simulated ones are rounded (`printed`)."""
        columns: dict[str, Sequence[str]] = {f"{layout.axis.name}_mm": number_cells(self.position_mm)}
        change_mm = printed(self.change_mm, simulated=self.simulated)
        columns |= {name: number_cells(values) for name, values in zip(layout.columns, change_mm.T, strict=True)}
        columns["round"] = list(self.round)
        if np.any(self.approach):
            columns["approach"] = [str(int(value)) for value in self.approach]
        if np.isfinite(self.time_s).any():
            columns["time_s"] = number_cells(self.time_s)
        return csv_text(columns, comment_lines(comment, simulated=self.simulated))

    def save(self, path: str | Path, layout: AxisLayout, *, comment: str = "") -> None:
        """Write the table atomically, after it was read back."""
        text = self.to_csv(layout, comment=comment)
        write_atomic(Path(path), text, check=lambda written: load_readings(written, layout))


def load_readings(path: str | Path, layout: AxisLayout) -> BeamReadings:
    """Read and check a table of readings.

    Raises `InputError`: with file, line and value: no header, a missing column, a cell that is not a number, no usable row.
    """
    path = Path(path)
    header, rows, comments = read_table(path)
    position = f"{layout.axis.name}_mm"
    needed = (position, *layout.columns)
    line = rows[0][0] - 1 if rows else 1
    refuse_contacts(header, needed, path, line)
    for name in needed:
        if name not in header:
            raise InputError(f"column {name} is missing", expected=f"columns {', '.join(needed)}", file=path, line=line)
    if not rows:
        raise InputError("no reading", expected="one row for each position below the header", file=path)
    known = {*needed, "round", "approach", "time_s"}
    cells = Cells(path, {name: i for i, name in enumerate(header)}, rows)
    table = BeamReadings(
        source=str(path),
        lines=read_only(np.array([line for line, _ in rows], dtype=int)),
        position_mm=cells.numbers(position),
        change_mm=read_only(np.stack([cells.numbers(name) for name in layout.columns], axis=1)),
        round=cells.words("round", "1"),
        approach=cells.signs("approach"),
        time_s=cells.numbers("time_s"),
        notices=(
            *(Message("the file says: {text}", text=text) for text in simulated_comments(comments)),
            *(unused_column_note(name, sorted(known)) for name in header if name not in known),
        ),
        simulated=bool(simulated_comments(comments)),
    )
    return _usable(table, layout)


def _usable(table: BeamReadings, layout: AxisLayout) -> BeamReadings:
    reasons: dict[int, Message] = {}

    def aside(rows: np.ndarray, reason: Message) -> None:
        for row in np.flatnonzero(rows):
            reasons.setdefault(int(row), reason)

    aside(~np.isfinite(table.position_mm), Message("a commanded position is missing or not finite"))
    aside(np.isinf(table.change_mm).any(axis=1), Message("a reading is not finite"))
    aside((np.abs(table.change_mm) > LARGEST_MM).any(axis=1), Message("a reading exceeds {most:g} mm", most=LARGEST_MM))
    aside(
        np.isfinite(table.change_mm).sum(axis=1) < FEWEST_BEAMS,
        Message("fewer than {fewest} beams were read", fewest=FEWEST_BEAMS),
    )
    lower, upper = layout.axis.lower, layout.axis.upper
    if lower is not None and upper is not None:
        beyond = outside_axis_range(layout.axis, table.position_mm)
        aside(
            beyond,
            Message(
                "the command of {name} is outside its range {lower:g} … {upper:g} mm",
                name=layout.axis.name,
                lower=lower,
                upper=upper,
            ),
        )
    keep = np.array([row not in reasons for row in range(len(table))])
    notes = tuple(RowNote(int(table.lines[row]), reason) for row, reason in sorted(reasons.items()))
    if not np.any(keep):
        raise InputError(f"no usable row: {notes[0].text}", expected="readings", file=table.source, line=notes[0].line)
    rows: dict[str, Any] = {
        field.name: read_only(getattr(table, field.name)[keep])
        for field in fields(table)
        if isinstance(getattr(table, field.name), np.ndarray)
    }
    return replace(table, **rows, set_aside=notes)


# --- Simulated readings of a multi-axis interferometer on one linear axis: true poses of the carriage, true installation, noi


def carriage_poses(
    layout: AxisLayout,
    machine: Machine,
    calibration: Calibration,
    positions_mm: np.ndarray,
    approach: np.ndarray | None = None,
) -> np.ndarray:
    """Return the true poses of the carriage; the other axes are in the middle of their ranges.

    ``positions_mm``: (n,) commanded; ``approach``: (n,) +1, −1, 0 of that axis; unknown if None; the reference position has none.

    Returns:
        (n, 6) relative to the pose at the reference position: translation of its origin, metres, and rotation vector, radians.

    Raises:
        InputError: a position outside the domain of a curve, or a missing channel that an effect needs.
    """
    q = np.concatenate([[layout.reference_mm], np.asarray(positions_mm, dtype=float)])
    full: dict[str, np.ndarray] = {}
    for axis in machine.axes:
        middle = 0.0 if axis.lower is None or axis.upper is None else (axis.lower + axis.upper) / 2.0
        full[axis.name] = np.full(len(q), middle)
    full[layout.axis.name] = q
    if approach is not None:
        full[f"approach_{layout.axis.name}"] = np.concatenate([[0.0], np.asarray(approach, dtype=float)])
    calibration.check(np.stack([full[name] for name in machine.names], axis=1))
    frame = next(i for i, f in enumerate(machine.frames) if (f.axis, f.role) == (layout.axis.name, "motion"))
    row = assemble(calibration.effects, machine.frames, full)[frame]
    errors = np.stack([np.broadcast_to(np.asarray(v, dtype=float), len(q)) for v in row], axis=1)
    turned = np.asarray(rotation_exp(errors[:, 3:]))
    # Motion, then error, then the translation to the carriage's point.
    point = layout.travel(q) + errors[:, :3] + turned @ layout.place
    back = turned[0].T
    return np.concatenate([(point[1:] - point[0]) @ back.T, rotation_log(back @ turned[1:])], axis=1)


def simulate_run(  # noqa: PLR0913
    layout: AxisLayout,
    machine: Machine,
    calibration: Calibration,
    positions_mm: np.ndarray,
    rng: np.random.Generator,
    *,
    rounds: np.ndarray | None = None,
    approach: np.ndarray | None = None,
    installation: np.ndarray | None = None,
    noise: bool = True,
) -> tuple[BeamReadings, np.ndarray]:
    """Simulate the readings of a run.

    ``positions_mm``: (n,) commanded; ``rounds``: (n,) names; one round if None; ``approach``: (n,) +1, −1, 0 of that axis; unknown if
    None; ``installation``: (p,) true deviations from the layout; drawn with its standard uncertainties if None; ``noise``: whether
    measurement noise is added.

    Returns:
        The readings, and the installation.

    Raises:
        InputError: as `carriage_poses`.
    """
    positions = np.atleast_1d(np.asarray(positions_mm, dtype=float))
    n = len(positions)
    poses = carriage_poses(layout, machine, calibration, positions, approach)
    true_installation = layout.installation_u * rng.standard_normal(len(layout.installation_u))
    if installation is not None:
        true_installation = np.array(installation, dtype=float)
    change = layout.beams.readings(poses, true_installation)
    noise_draw = layout.noise * rng.standard_normal(change.shape)
    change = change + noise_draw if noise else change
    readings = BeamReadings(
        source="simulated",
        lines=read_only(np.arange(1, n + 1)),
        position_mm=read_only(positions),
        change_mm=read_only(change / MM / (2.0 if layout.halved else 1.0)),
        round=read_only(np.full(n, "1", dtype=object) if rounds is None else np.array(rounds, dtype=object)),
        approach=read_only(np.zeros(n) if approach is None else np.array(approach, dtype=float)),
        time_s=read_only(np.full(n, np.nan)),
        simulated=True,
    )
    return readings, read_only(true_installation)
