"""The file of a part: its features, its tolerances, and the shapes of the tools that finish it (`part.yaml`).

Features are nominal surfaces in the part's frame. Size is not judged: a diameter says where a surface is, not whether it is met.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, Literal, final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PrivateAttr
from scipy.spatial import cKDTree

from twin._common.errors import InputError, closest_name
from twin._common.units import DEG
from twin._common.yaml_files import EntryPath, line_of, load_yaml

SCHEMA: Final = "twin.part/1"
Vector = Annotated[tuple[float, float, float], Field(description="x, y, z")]
Positive = Annotated[float, Field(gt=0.0, lt=1e5)]
Kind = Literal[
    "position",
    "flatness",
    "roundness",
    "perpendicularity",
    "parallelism",
    "angularity",
    "coaxiality",
    "profile",
]
LOCATED: Final = ("position", "coaxiality")
ORIENTED: Final = ("perpendicularity", "parallelism", "angularity")
OF_FORM: Final = ("flatness", "roundness")
MOST_DATUMS: Final = 3
REFERENCE_DEGC: Final = 20.0


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


@final
class ToolShape(_Entry):
    """Shape of a tool: an end mill with a corner radius (0: sharp, half the diameter: ball), or a drill, reamer or tap.

    The tip is the lowest point on the tool's axis, as for a ball-nose tool measured at its pole.
    """

    number: str | int  # or its name, as the program calls it
    diameter: Positive
    corner_radius: Annotated[float, Field(ge=0.0)] = 0.0
    length: Annotated[float, Field(ge=0.0)] | None = (
        None  # from the spindle nose to the tip, mm; the program's tool if not given
    )
    cutting_length: Positive | None = None  # of the flanks, from the tip; twice the diameter if not given

    @property
    def radius(self) -> float:
        """Outer radius, mm."""
        return self.diameter / 2.0

    @property
    def reach(self) -> float:
        """Length of the cutting flanks from the tip, mm."""
        return self.cutting_length or 2.0 * self.diameter


class _Feature(_Entry, ABC):
    """A feature; ``tool`` and ``lines`` restrict it to the blocks of one tool, and to those between two lines of the program."""

    tool: str | int | None = None
    lines: tuple[int, int] | None = None
    within: tuple[Vector, Vector] | None = None  # opposite corners of a box, in the part's frame, mm
    made: Literal["here", "elsewhere"] = "here"  # elsewhere: exact, and placed with the uncertainty of the set-up

    @abstractmethod
    def signed_mm(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (n,) distances of points (n, 3) from the surface, positive outside the material, and (n, 3) outward normals."""

    @abstractmethod
    def samples(self) -> np.ndarray:
        """Return (n, 3) points spread over the nominal surface, for a feature that is made elsewhere."""

    def direction_of(self) -> np.ndarray | None:
        """Return the unit vector (3,) of its normal or axis; None for a sphere."""
        vector = getattr(self, "normal", None) or getattr(self, "direction", None)
        return None if vector is None else _unit(vector)

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Return (n,) whether points belong to the feature's extent."""
        return self.within_box(points)

    def within_box(self, points: np.ndarray) -> np.ndarray:
        """Return (n,) whether points lie in its box; all do without one."""
        if self.within is None:
            return np.ones(len(points), dtype=bool)
        low, high = np.sort(np.array(self.within), axis=0)
        return np.asarray(((points >= low - EXTENT_MM) & (points <= high + EXTENT_MM)).all(axis=1))


EXTENT_MM: Final = 0.01
AROUND: Final = 24
ALONG: Final = 5


def _unit(vector: Vector) -> np.ndarray:
    length = float(np.linalg.norm(vector))
    if length < 1e-9:
        raise ValueError("a direction of length zero")
    return np.array(vector) / length


def across(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors perpendicular to a direction and to each other."""
    least = np.eye(3)[np.abs(direction).argmin()]
    first = np.cross(direction, least)
    first /= np.linalg.norm(first)
    return first, np.cross(direction, first)


@final
class PlaneFeature(_Feature):
    """A plane: a point, and the direction out of the material."""

    kind: Literal["plane"]
    point: Vector
    normal: Vector
    size: tuple[Positive, Positive] = (100.0, 100.0)  # of one that is made elsewhere

    def signed_mm(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return distances and normals."""
        n = _unit(self.normal)
        return (points - np.array(self.point)) @ n, np.broadcast_to(n, points.shape)

    def samples(self) -> np.ndarray:
        """Return points on the plane."""
        e = np.array(across(_unit(self.normal)))
        grid = np.stack(np.meshgrid(*(np.linspace(-s / 2.0, s / 2.0, ALONG) for s in self.size)), axis=-1).reshape(
            -1, 2
        )
        return np.array(self.point) + grid @ e


class Turned(_Feature):
    """A surface of revolution about an axis from ``point`` along ``direction``; ``depth``: its extent along it."""

    point: Vector
    direction: Vector = (0.0, 0.0, -1.0)
    depth: Annotated[float, Field(gt=0.0)] | None = None
    internal: bool = True  # a hole; otherwise the material is inside

    @property
    def unit(self) -> np.ndarray:
        """(3,) the axis's direction, of length one."""
        return _unit(self.direction)

    def along_mm(self, points: np.ndarray) -> np.ndarray:
        """Return (n,) places along the axis, mm."""
        return np.asarray((points - np.array(self.point)) @ self.unit)

    def radial(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (n,) distances from the axis, and (n, 3) directions away from it."""
        u = self.unit
        off = points - np.array(self.point)
        off = off - np.outer(off @ u, u)
        distance = np.linalg.norm(off, axis=1)
        return distance, off / np.maximum(distance, 1e-12)[:, None]

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Return whether points lie between the ends of the surface."""
        found = super().inside(points)
        if self.depth is None:
            return found
        along = self.along_mm(points)
        return found & (along >= -EXTENT_MM) & (along <= self.depth + EXTENT_MM)

    def axis_point(self, along: np.ndarray) -> np.ndarray:
        """Return (n, 3) points of the axis."""
        return np.asarray(np.array(self.point) + np.outer(along, self.unit))

    def samples(self) -> np.ndarray:
        """Return points around the axis."""
        along = np.linspace(0.0, self.depth or 1.0, ALONG)
        angle = np.arange(AROUND) * (2.0 * np.pi / AROUND)
        e = np.array(across(self.unit))
        around = np.column_stack([np.cos(angle), np.sin(angle)]) @ e
        radii = self._radius_at(along)
        return np.concatenate([self.axis_point(along[i : i + 1]) + radii[i] * around for i in range(len(along))])

    @abstractmethod
    def _radius_at(self, along: np.ndarray) -> np.ndarray:
        """Return the radius at places along the axis."""


@final
class CylinderFeature(Turned):
    """A hole, bore or boss: a point of its axis, and the axis's direction into the material."""

    kind: Literal["hole", "cylinder"]
    diameter: Positive

    def signed_mm(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return distances and normals."""
        distance, away = self.radial(points)
        sign = -1.0 if self.internal else 1.0
        return sign * (distance - self.diameter / 2.0), sign * away

    def _radius_at(self, along: np.ndarray) -> np.ndarray:
        return np.full(len(along), self.diameter / 2.0)


@final
class ConeFeature(Turned):
    """A cone: its diameter at ``point``, and half its apex angle; it widens along its direction for a positive one."""

    kind: Literal["cone"]
    diameter: Annotated[float, Field(ge=0.0)]
    half_angle_deg: Annotated[float, Field(gt=-89.0, lt=89.0)]

    def signed_mm(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return distances and normals."""
        distance, away = self.radial(points)
        angle = self.half_angle_deg * DEG
        sign = -1.0 if self.internal else 1.0
        off = (distance - self._radius_at(self.along_mm(points))) * np.cos(angle)
        return sign * off, sign * (np.cos(angle) * away - np.sin(angle) * self.unit)

    def _radius_at(self, along: np.ndarray) -> np.ndarray:
        return np.asarray(self.diameter / 2.0 + along * np.tan(self.half_angle_deg * DEG))


@final
class SphereFeature(_Feature):
    """A sphere, or a part of it."""

    kind: Literal["sphere"]
    centre: Vector
    diameter: Positive
    internal: bool = False

    def signed_mm(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return distances and normals."""
        off = points - np.array(self.centre)
        distance = np.linalg.norm(off, axis=1)
        sign = -1.0 if self.internal else 1.0
        return sign * (distance - self.diameter / 2.0), sign * off / np.maximum(distance, 1e-12)[:, None]

    def samples(self) -> np.ndarray:
        """Return points on the sphere."""
        directions = np.stack(np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
        directions = directions[np.any(directions != 0.0, axis=1)]
        length = np.linalg.norm(directions, axis=1, keepdims=True)
        return np.asarray(np.array(self.centre) + self.diameter / 2.0 * directions / length)


@final
class PointsFeature(_Feature):
    """A free-form surface by points on it, each with the direction out of the material: x, y, z, nx, ny, nz.

    Without points it is what the program means to cut between two lines, at a side of the tool: left or right of its way, or below.
    """

    kind: Literal["points"]
    points: tuple[tuple[float, float, float, float, float, float], ...] = ()
    side: Literal["left", "right", "below"] | None = None

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.samples())

    @cached_property
    def _normals(self) -> np.ndarray:
        return np.array([_unit(one[3:]) for one in self.points])

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (n,) the surface's point nearest to each of (n, 3), and (n,) its distance along the surface."""
        which = self._tree.query(points)[1]
        off = points - self.samples()[which]
        normal = self._normals[which]
        return which, np.linalg.norm(off - (off * normal).sum(axis=1)[:, None] * normal, axis=1)

    def signed_mm(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return distances and normals: those of the tangent plane at the nearest point."""
        which = self._tree.query(points)[1]
        normal = self._normals[which]
        return ((points - self.samples()[which]) * normal).sum(axis=1), normal

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Return whether points lie beside one of the surface's."""
        return np.asarray(super().inside(points) & (self.nearest(points)[1] <= BESIDE_MM))

    def samples(self) -> np.ndarray:
        """Return the points."""
        return np.array(self.points)[:, :3]


BESIDE_MM: Final = 0.5
"""Distance along a free-form surface, up to which a contact of the tool makes one of its points."""
Feature = Annotated[
    PlaneFeature | CylinderFeature | ConeFeature | SphereFeature | PointsFeature, Field(discriminator="kind")
]
Surface = PlaneFeature | CylinderFeature | ConeFeature | SphereFeature | PointsFeature


@final
class Tolerance(_Entry):
    """A tolerance of the drawing: the zone's width or diameter, mm, and its datums in their order."""

    name: str = ""
    kind: Kind
    of: str | tuple[str, ...]
    zone: Positive
    datums: tuple[str, ...] = Field(default=(), max_length=MOST_DATUMS)

    @property
    def features(self) -> tuple[str, ...]:
        """Names of the features that it holds for; those of a pattern are judged together."""
        return (self.of,) if isinstance(self.of, str) else self.of

    @property
    def title(self) -> str:
        """Name, or kind, zone and features."""
        datums = f" | {' | '.join(self.datums)}" if self.datums else ""
        return self.name or f"{self.kind} {self.zone:g} of {', '.join(self.features)}{datums}"


@final
class SetUpUncertainty(_Entry):
    """Standard uncertainty of the part's place on the table: shift (µm) and rotation (µrad) along and about x, y, z."""

    x_um: Annotated[float, Field(ge=0.0)] = 0.0
    y_um: Annotated[float, Field(ge=0.0)] = 0.0
    z_um: Annotated[float, Field(ge=0.0)] = 0.0
    a_urad: Annotated[float, Field(ge=0.0)] = 0.0
    b_urad: Annotated[float, Field(ge=0.0)] = 0.0
    c_urad: Annotated[float, Field(ge=0.0)] = 0.0

    @property
    def standard(self) -> np.ndarray:
        """(6,) µm and mrad."""
        return np.array([self.x_um, self.y_um, self.z_um, *(1e-3 * v for v in (self.a_urad, self.b_urad, self.c_urad))])


@final
class PartTemperature(_Entry):
    """Temperature of the part while it is cut, with its standard uncertainty, and its coefficient of thermal expansion.

    The drawing holds at 20 °C (ISO 1). The part shrinks towards its zero.
    """

    degC: Annotated[float, Field(gt=-50.0, lt=200.0)] = REFERENCE_DEGC
    u_K: Annotated[float, Field(ge=0.0, lt=50.0)] = 0.0
    expansion_um_m_K: Annotated[float, Field(ge=0.0, lt=100.0)] = 0.0

    @property
    def mean_K(self) -> float:
        """Temperature above that of the drawing."""
        return self.degC - REFERENCE_DEGC


class _PartFile(_Entry):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True)

    schema_: Literal["twin.part/1"] = Field(alias="schema")
    part: str = ""
    units: Literal["mm"]
    zero: Literal["program", "table"] | Vector = "program"
    tools: tuple[ToolShape, ...] = Field(min_length=1)
    touch_mm: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02
    association: Literal["least-squares", "minimum-zone"] = "minimum-zone"
    setup: SetUpUncertainty = SetUpUncertainty()
    temperature: PartTemperature = PartTemperature()
    features: Mapping[str, Feature]
    tolerances: tuple[Tolerance, ...] = Field(min_length=1)
    _lines: dict[EntryPath, int] = PrivateAttr(default_factory=dict)


@final
class PartDrawing:
    """A part as its file describes it.

    Attributes:
        path: the file.
        features: nominal surfaces by name.
        tolerances: as on the drawing.
        tools: shapes of tools by number or name.
        zero: where the part's zero is: that of the program, the table's centre, or a place in the work frame, mm.
        touch_mm: distance from a nominal surface up to which a tool touches it.
        association: of form: least squares or minimum zone.
        setup: uncertainty of the part's place, for features that are made elsewhere.
        temperature: of the part while it is cut.

    Raises:
        InputError: with file, line and value.

    Examples:
        >>> import json
        >>> from pathlib import Path
        >>> part = {
        ...     "schema": "twin.part/1",
        ...     "units": "mm",
        ...     "tools": [{"number": 1, "diameter": 8}],
        ...     "features": {"A": {"kind": "plane", "point": [0, 0, 30], "normal": [0, 0, 1]}},
        ...     "tolerances": [{"kind": "flatness", "of": "A", "zone": 0.01}],
        ... }
        >>> _ = Path("part.yaml").write_text(json.dumps(part))
        >>> twin.PartDrawing(Path("part.yaml")).tolerances[0].title
        'flatness 0.01 of A'
    """

    def __init__(self, path: Path) -> None:
        entry, self._lines = load_yaml(path, _PartFile, SCHEMA)
        self.path, self.name, self.zero = path, entry.part or path.stem, entry.zero
        self.features: dict[str, Surface] = dict(entry.features)
        self.tolerances, self.association, self.touch_mm = entry.tolerances, entry.association, entry.touch_mm
        self.tools = {str(shape.number): shape for shape in entry.tools}
        self.setup, self.temperature = entry.setup, entry.temperature
        self._check()

    def refused(self, at: tuple[Any, ...], what: str, expected: str, value: object = None) -> InputError:
        """Return the error at an entry of the file."""
        return InputError(what, expected=expected, file=self.path, line=line_of(at, self._lines), value=value)

    def _check(self) -> None:
        if not self.temperature.expansion_um_m_K and self.temperature != PartTemperature():
            raise self.refused(
                ("temperature",),
                "a temperature without a coefficient of expansion",
                "expansion_um_m_K: 11.5, aluminium 23.8",
            )
        for i, shape in enumerate(self.tools.values()):
            if shape.corner_radius > shape.radius + 1e-9:
                raise self.refused(
                    ("tools", i, "corner_radius"), "a corner radius larger than the tool's",
                    f"at most half of its diameter, {shape.radius:g}", shape.corner_radius,
                )  # fmt: skip
        for name, feature in self.features.items():
            self._check_feature(name, feature)
        for i, tolerance in enumerate(self.tolerances):
            self._check_tolerance(i, tolerance)

    def _check_feature(self, name: str, feature: Surface) -> None:
        if feature.tool is not None and str(feature.tool) not in self.tools:
            raise self.refused(
                ("features", name, "tool"), "no such tool", f"one of {', '.join(self.tools)}", feature.tool
            )
        for key in ("normal", "direction"):
            vector = getattr(feature, key, None)
            if vector is not None and np.linalg.norm(vector) < 1e-9:
                raise self.refused(("features", name, key), "a direction of length zero", "another", vector)
        if not isinstance(feature, PointsFeature):
            return
        cut = feature.side is not None and feature.lines is not None and feature.made == "here"
        if bool(feature.points) == cut or (feature.side is not None) != cut:
            raise self.refused(
                ("features", name), "free-form points, and where they are from",
                "points: [[x, y, z, nx, ny, nz], …]; or side: left, right or below, with the lines of a path that cuts here",
            )  # fmt: skip
        for i, point in enumerate(feature.points):
            if abs(np.linalg.norm(point[3:]) - 1.0) > UNIT:
                raise self.refused(
                    ("features", name, "points", i),
                    "a normal that is not of length one",
                    "x, y, z, nx, ny, nz",
                    point,
                )

    def _check_tolerance(self, i: int, tolerance: Tolerance) -> None:
        for key, names in (("of", tolerance.features), ("datums", tolerance.datums)):
            for name in names:
                if name not in self.features:
                    raise InputError(
                        "no such feature",
                        expected=f"one of {', '.join(self.features)}",
                        file=self.path,
                        line=line_of(("tolerances", i, key), self._lines),
                        value=name,
                        nearest=closest_name(name, [*self.features]),
                    )
        kind, datums = tolerance.kind, tolerance.datums
        surfaces = [self.features[name] for name in tolerance.features]
        planes = [isinstance(one, PlaneFeature) for one in surfaces]
        free = any(isinstance(one, PointsFeature) for one in surfaces)
        by_points = any(isinstance(self.features[name], PointsFeature) for name in datums)
        turned = [isinstance(one, Turned) for one in surfaces]
        with_axes = all(turned) and all(isinstance(self.features[name], Turned) for name in datums)
        repeated = len(set(datums)) < len(datums) or bool(set(datums) & set(tolerance.features))
        for wrong, key, what, expected in (
            (repeated, "datums", "a datum twice, or its own", "others"),
            (
                any(one.made == "elsewhere" for one in surfaces),
                "of",
                "a feature that this program does not make",
                "features made here",
            ),
            (
                kind in ORIENTED and not self._is_so(kind, tolerance.features, datums[:1]),
                "kind",
                f"nominal directions that are not those of {kind}",
                "planes or axes that are so on the drawing",
            ),
            (kind == "flatness" and not all(planes), "kind", "flatness without a plane", "a plane, or profile"),
            (free and kind != "profile", "kind", f"{kind} of free-form points", "profile"),
            (by_points, "datums", "a datum of free-form points", "planes, holes, cylinders, cones, spheres"),
            (kind == "roundness" and any(planes), "kind", "roundness of a plane", "a hole, cylinder, cone or sphere"),
            (kind == "coaxiality" and not with_axes, "kind", "coaxiality without axes", "holes, cylinders or cones"),
            (kind in OF_FORM and bool(datums), "datums", f"{kind} has no datums", "none"),
            (kind in (*LOCATED, *ORIENTED) and not datums, "kind", f"{kind} without a datum", "datums: [A] or more"),
            (len({*turned}) > 1, "of", "features with and without an axis in one tolerance", "features of one kind"),
        ):
            if wrong:
                raise self.refused(("tolerances", i, key), what, expected, getattr(tolerance, key))

    def _is_so(self, kind: Kind, names: Sequence[str], datums: Sequence[str]) -> bool:
        """Return whether features have a direction, and are nominally perpendicular or parallel to their first datum."""
        of_features, of_datums = (
            [(isinstance(one, Turned), one.direction_of()) for one in map(self.features.__getitem__, some)]
            for some in (names, datums)
        )
        for axis, own in of_features:
            for datum_axis, datum in of_datums:
                if own is None or datum is None:
                    return False
                along = abs(float(own @ datum))
                # The normal of a plane is across what is parallel to it.
                across = along < DIRECTION if axis == datum_axis else along > 1.0 - DIRECTION
                parallel = along > 1.0 - DIRECTION if axis == datum_axis else along < DIRECTION
                if (kind == "perpendicularity" and not across) or (kind == "parallelism" and not parallel):
                    return False
        return True


DIRECTION: Final = 1e-6
UNIT: Final = 1e-3
