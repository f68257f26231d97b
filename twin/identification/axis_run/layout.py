"""A layout file: a multi-axis interferometer on one linear axis of a machine, with its uncertainties."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal, final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.units import MM, UM, URAD
from twin._common.yaml_files import EntryPath, line_of, load_yaml
from twin.machine.machine import Axis, Machine
from twin.measurement.instruments.multi_axis import MultiAxis

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
        name: its name in the file.
        axis: the axis.
        beams: the nominal layout.
        reference_mm: commanded position at which the counters were set to zero.
        place: (3,) the carriage's point, from the origin of the axis's error frame.
        halved: whether a reading is half the change of path.
        noise: standard uncertainty of a change of path.
        installation_u: (p,) standard uncertainties in the order of `MultiAxis.installation`.
        path: the file.
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
        """Read and check a layout file.

        Raises:
            InputError: with file, line, value and what was expected.
        """
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
                distance=read_only(np.array([one.distance_mm for one in entries.mirrors.values()]) * MM),
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
