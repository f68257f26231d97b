"""Plain solids that look like a described machine: boxes and cylinders for the scene and for clearance, with estimated masses.

Coordinates are those of the base frame with every axis at rest, in metres, turned by `UPRIGHT_FRAMES`: z is up, and the column is
behind (+y).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple, final

import numpy as np

from twin._common.units import MM
from twin.machine.machine_file import UPRIGHT_FRAMES

if TYPE_CHECKING:
    from twin.machine.description import Description, Part, Placed

COLOURS: Final[Mapping[str, str]] = {
    **{"white": "0.93 0.94 0.94", "grey": "0.74 0.76 0.78", "cast": "0.6 0.63 0.66", "dark": "0.2 0.22 0.25"},
    **{"rail": "0.55 0.58 0.62", "bright": "0.82 0.84 0.86", "red": "0.85 0.12 0.1", "blue": "0.05 0.2 0.45"},
}
DENSITY: Final = 1500.0
"""kg/m³ of the outline of a solid: a hollow casting."""
UPRIGHT: Final = 0.985
"""Cosine of the angle, 10°, up to which a rotary axis is drawn as one about the vertical."""
LEVEL: Final = 0.17
"""Sine of the same angle: a rotary axis up to it is drawn as a horizontal one."""


class Solid(NamedTuple):
    """A box, or a cylinder about its own z: size (3,) (radius, radius, length), orientation (3, 3), centre (3,)."""

    kind: str
    size: np.ndarray
    turn: np.ndarray
    centre: np.ndarray
    colour: str


@final
class Solids:
    """The solids of a machine by link.

    Args:
        description: the machine.
    """

    def __init__(self, description: Description) -> None:
        self._links = {part.name: f"{part.name.lower()}_link" for part in description.parts}
        self._upright = turn = UPRIGHT_FRAMES[description.up]
        self._towards_spindle = turn @ description.tool_axis
        self._parts = tuple(replace(one, motion=turn @ one.motion, point=turn @ one.point) for one in description.parts)
        self._found: dict[str, list[Solid]] = {}
        answers = description.answers
        self._travel = {letter: (0.0, 0.0) for letter in "XYZ"}
        for name, origin in answers.table.items():
            reach, k = answers.axes[name].range, self._along(name)
            if not isinstance(reach, str):
                ends = sorted((end - origin) * MM * float(turn[k, "XYZ".index(name[0])]) for end in reach)
                self._travel["XYZ"[k]] = ends[0], ends[1]
        spans = [high - low for low, high in (self._travel["X"], self._travel["Y"]) if high > low]
        shown = min(1.2, max(0.16, 0.7 * min(spans, default=0.4)))
        self._radius = 0.5 * (shown if answers.table_size is None else answers.table_size * MM)
        self._half = self._floor = self._top = 0.0
        self._work_side()
        self._tool_side()

    def box(
        self, link: str, low: Sequence[float] | np.ndarray, high: Sequence[float] | np.ndarray, colour: str
    ) -> None:
        """Add a box between two corners."""
        a, b = np.minimum(low, high), np.maximum(low, high)
        self._found.setdefault(link, []).append(Solid("box", b - a, np.eye(3), 0.5 * (a + b), colour))

    def rod(self, link: str, start: np.ndarray, end: np.ndarray, radius: float, colour: str) -> None:
        """Add a cylinder between two points."""
        along = end - start
        length = float(np.linalg.norm(along))
        if length > 1e-6:
            size = np.array([radius, radius, length])
            self._found.setdefault(link, []).append(
                Solid("cylinder", size, from_z(along / length), 0.5 * (start + end), colour)
            )

    def _of(self, side: str, *, linear: bool) -> list[Part]:
        """Return the axes of a side from its end to the bed."""
        return [part for part in reversed(self._parts) if part.side == side and (part.name[0] in "XYZ") == linear]

    def _along(self, name: str) -> int:
        """Return the coordinate along which a linear axis moves."""
        return int(np.argmax(np.abs(self._upright[:, "XYZ".index(name[0])])))

    def _carrier(self, part: Part) -> str:
        own = [one for one in self._parts if one.side == part.side]
        index = own.index(part)
        return self._links[own[index - 1].name] if index else "base"

    # --- The side of the workpiece -------------------------------------------------------------------

    def _work_side(self) -> None:
        """Add table, housings of its rotary axes, slides and bed, from the table's surface downwards."""
        r, rotary = self._radius, self._of("work", linear=False)
        if rotary and abs(rotary[0].frame_z[2]) > LEVEL:
            self.rod("table", _at(z=-0.05), _at(), r, "bright")
            self.box("table", (-0.01, -r, -0.04), (0.01, -0.9 * r, 0.001), "red")
        else:
            self.box("table", (-r, -0.7 * r, -0.05), (r, 0.7 * r, 0.0), "bright")
        for y in (-0.45 * r, 0.0, 0.45 * r):
            self.box("table", (-0.8 * r, y - 0.006, -0.012), (0.8 * r, y + 0.006, 0.0005), "dark")
        under = -0.05
        for part in rotary:
            under = self._table_axis(part, under)
        for part in self._of("work", linear=True):
            wide = np.array([max(r, 0.2) + 0.1, max(r, 0.2) + 0.02, 0.0])
            self.box(self._links[part.name], _at(z=under - 0.1) - wide, _at(z=under - 0.004) + wide, "grey")
            under -= 0.13
            k = self._along(part.name)
            low, high = self._travel["XYZ"[k]]
            for sign in (-0.7, 0.7):
                rail = np.where(np.arange(3) == (0 if k else 1), sign * wide, 0.0) + _at(z=under)
                # The slide moves against the command of the tool.
                reach = np.where(np.arange(3) == k, wide, 0.0)
                ends = [np.where((np.arange(3) == k) & (k < 2), -end, 0.0) for end in (high, low)]
                self.box(
                    self._carrier(part),
                    rail + ends[0] - reach - 0.015,
                    rail + ends[1] + reach + _at(0.015, 0.015, 0.03),
                    "rail",
                )
        wide_x, deep_y = self._travel["X"], self._travel["Y"]
        self._half = max(r + 0.3, 0.5 * (wide_x[1] - wide_x[0]) + 0.25)
        front, back = -max(r + 0.25, 0.2 - deep_y[0]), max(r + 0.55, deep_y[1] + 0.5)
        self._floor, self._top = under - 0.4, under - 0.005
        self.box("base", (-self._half, front, self._floor), (self._half, back, self._top), "white")
        edge = 0.005
        self.box(
            "base",
            (-self._half - edge, front - edge, under - 0.08),
            (self._half + edge, back + edge, under - 0.05),
            "blue",
        )

    def _table_axis(self, part: Part, under: float) -> float:
        """Add the housing of a rotary axis of the table; return the height below it."""
        r, own, carrier, p, z = self._radius, self._links[part.name], self._carrier(part), part.point * MM, part.frame_z
        if abs(z[2]) > UPRIGHT:
            self.rod(carrier, _at(p[0], p[1], under - 0.1), _at(p[0], p[1], under - 0.002), 0.8 * r, "white")
            return under - 0.1
        if abs(z[2]) < LEVEL:  # a trunnion: a cradle between two posts
            low = min(under - 0.01, float(p[2]) - 0.08)
            along, across = np.abs(z), (1.0 - np.abs(z)) * [1.0, 1.0, 0.0]
            middle, foot = p * across, low - 0.12
            size = along * (r + 0.08) + across * 0.45 * r
            self.box(own, middle - size + _at(z=low - 0.05), middle + size + _at(z=low), "cast")
            for sign in (-1.0, 1.0):
                arm, hub = middle + sign * (r + 0.06) * z, middle + _at(z=p[2]) + sign * (r + 0.06) * z
                self.box(
                    own,
                    arm - 0.02 * along - 0.1 * across + _at(z=low - 0.05),
                    hub + 0.02 * along + 0.1 * across,
                    "cast",
                )
                self.rod(own, hub, hub + sign * 0.045 * z, 0.08, "bright")
                self.rod(carrier, hub + sign * 0.05 * z, hub + sign * 0.17 * z, 0.12, "white")
                size = 0.05 * along + 0.11 * across
                post = arm + sign * 0.1 * z
                self.box(carrier, post - size + _at(z=foot), post + size + _at(z=p[2]), "white")
            return foot
        # An inclined axis: a bearing behind and below, and an arm to the housing of the table.
        down = -z if z[2] > 0.0 else z
        bearing = p + down * (0.25 + r)
        inner = p + down * (0.55 * (0.25 + r))
        self.rod(own, bearing, inner, 0.45 * r + 0.05, "cast")
        self.rod(own, inner, _at(z=under - 0.06), 0.07, "white")
        self.rod(own, _at(z=under - 0.09), _at(z=under - 0.002), 0.7 * r, "white")
        block = bearing + 0.1 * down
        self.rod(carrier, bearing + 0.14 * down, bearing, 0.5 * r + 0.07, "white")
        foot = min(float(bearing[2]) - 0.25, under - 0.25)
        self.box(carrier, (block[0] - 0.2, block[1] - 0.12, foot), (block[0] + 0.2, block[1] + 0.12, block[2]), "cast")
        return foot

    # --- The side of the tool ------------------------------------------------------------------------

    def _tool_side(self) -> None:
        """Add spindle, head, slides and column, from the spindle nose upwards and backwards."""
        along, head, slides = self._towards_spindle, self._of("tool", linear=False), self._of("tool", linear=True)
        at = 0.12 * along
        self.rod("spindle_nose", _at(), 0.03 * along, 0.025, "dark")
        self.rod("spindle_nose", 0.03 * along, 0.06 * along, 0.04, "rail")
        self.rod("spindle_nose", 0.06 * along, at, 0.065, "cast")
        if along[1] > UPRIGHT:
            self._horizontal_spindle(at, head, slides)
            return
        if along[2] < UPRIGHT:  # a right-angle head
            self.box("spindle_nose", at - 0.07, at + 0.07, "cast")
            at = at + _at(z=0.07)
        for part in head:
            at = self._head_axis(part, at)
        if not head:
            self.rod("spindle_nose", at, _at(at[0], at[1], 0.25), 0.08, "cast")
            at = _at(at[0], at[1], 0.25)
        letters = ""
        for part in slides:
            at = self._slide(part, at, letters)
            letters += "XYZ"[self._along(part.name)]
        if "X" not in letters:
            self.box("base", at + _at(-0.25, 0.0, self._floor - at[2]), at + _at(0.25, 0.4, 0.3), "white")
        elif letters.endswith("X"):
            for sign in (-1.0, 1.0):
                post = _at(sign * self._half, at[1], self._floor)
                self.box("base", post, post + _at(-sign * 0.14, 0.2, at[2] + 0.19 - self._floor), "white")
        elif "X" not in letters[: letters.find("Y")]:  # a ram on a cross slide
            self.box("base", _at(-self._half, at[1], self._floor), _at(self._half, at[1] + 0.3, at[2]), "white")

    def _horizontal_spindle(self, at: np.ndarray, head: Sequence[Part], slides: Sequence[Part]) -> None:
        """Add head, headstock, column and slides behind a horizontal spindle that begins at a point."""
        own = "spindle_nose"
        for part in head:
            p, z = part.point * MM, part.frame_z
            self.rod(own, at, p, 0.07, "cast")
            own = self._links[part.name]
            self.rod(own, p - 0.12 * z, p + 0.12 * z, 0.1, "white")
            at = p + _at(y=0.1)
        inner, outer = at - _at(0.15, 0.0, 0.15), at + _at(0.15, 0.45, 0.15)
        self.box(own, inner, outer, "grey")
        foot, raised = _at(at[0], at[1] + 0.25, inner[2]), False
        for part in slides:
            k, carrier = self._along(part.name), self._carrier(part)
            low, high = self._travel["XYZ"[k]]
            own = self._links[part.name]
            if k == 2 and not raised:
                raised, bottom = True, self._top + 0.12 * (len(slides) - 1)
                for sign in (-1.0, 1.0):
                    post = _at(foot[0] + sign * 0.17, foot[1] - 0.15, bottom)
                    self.box(
                        carrier,
                        post,
                        _at(post[0] + sign * 0.14, post[1] + 0.3, outer[2] + max(high, 0.0) + 0.05),
                        "white",
                    )
                foot = _at(foot[0], foot[1], bottom)
                continue
            half = np.array([0.33, 0.3, 0.0])
            self.box(own, foot - half - _at(z=0.08), foot + half, "grey")
            reach = [np.where(np.arange(3) == k, end, 0.0) for end in (min(low, 0.0), max(high, 0.0))]
            self.box(carrier, foot - half + reach[0] - _at(z=0.12), foot + half + reach[1] - _at(z=0.08), "rail")
            foot = foot - _at(z=0.12)
        if not raised:
            self.box(own, foot - _at(0.15, 0.15, 0.0), foot + _at(0.15, 0.15, 0.0), "white")
        self.box(
            "base",
            _at(foot[0] - 0.35, foot[1] - 0.3, self._floor),
            _at(foot[0] + 0.35, foot[1] + 0.3, foot[2]),
            "white",
        )

    def _head_axis(self, part: Part, at: np.ndarray) -> np.ndarray:
        """Add the housing of a rotary axis of the head; return where the part that carries it begins."""
        own, carrier, p, z = self._links[part.name], self._carrier(part), part.point * MM, part.frame_z
        if abs(z[2]) > UPRIGHT:
            top = _at(p[0], p[1], max(at[2], p[2]) + 0.08)
            self.rod(own, _at(p[0], p[1], at[2]), top, 0.13, "cast")
            self.rod(carrier, top, top + _at(z=0.08), 0.14, "white")
            return top + _at(z=0.08)
        if abs(z[2]) < LEVEL:  # a fork
            along, across = np.abs(z), (1.0 - np.abs(z)) * [1.0, 1.0, 0.0]
            self.rod(own, at, _at(at[0], at[1], p[2]), 0.075, "cast")
            self.rod(own, p - 0.1 * z, p + 0.1 * z, 0.085, "cast")
            for sign in (-1.0, 1.0):
                self.rod(carrier, p + sign * 0.1 * z, p + sign * 0.16 * z, 0.09, "white")
                self.rod(carrier, p + sign * 0.13 * z, p + sign * 0.13 * z + _at(z=0.2), 0.04, "white")
            size = 0.17 * along + 0.09 * across
            self.box(carrier, p - size + _at(z=0.17), p + size + _at(z=0.25), "white")
            return p + _at(z=0.25)
        up = z if z[2] > 0.0 else -z
        face = p + up * max(0.0, (at[2] + 0.1 - p[2]) / up[2])
        self.rod(own, at, face - 0.02 * up, 0.06, "cast")
        self.rod(own, face - 0.06 * up, face, 0.13, "cast")
        self.rod(carrier, face, face + 0.12 * up, 0.135, "white")
        end = face + 0.1 * up
        self.rod(carrier, end, end + _at(z=0.18), 0.11, "white")
        return end + _at(z=0.16)

    def _slide(self, part: Part, at: np.ndarray, inside: str) -> np.ndarray:
        """Add the moving part of a linear axis and the guideways on the link that carries it; return where that link begins.

        Args:
            part: the axis.
            at: where its moving part begins.
            inside: letters of the linear axes that it carries.
        """
        own, carrier = self._links[part.name], self._carrier(part)
        letter = "XYZ"[self._along(part.name)]
        low, high = self._travel[letter]
        if letter == "Z":
            fixed = at[2] + max(high, 0.0) + 0.05
            self.box(own, at + _at(-0.1, -0.08, 0.0), at + _at(0.1, 0.1, fixed + 0.3 - at[2] - min(low, 0.0)), "white")
            self.box(own, at + _at(-0.09, -0.085, 0.05), at + _at(0.09, -0.08, 0.1), "blue")
            saddle = _at(at[0], at[1] + 0.105, fixed)
            self.box(carrier, saddle - _at(0.17, 0.0, 0.0), saddle + _at(0.17, 0.075, 0.35), "grey")
            return saddle + _at(0.0, 0.075, 0.18)
        if letter == "X":
            self.box(own, at - _at(0.2, 0.0, 0.2), at + _at(0.2, 0.05, 0.2), "grey")
            gantry = carrier.startswith("y")
            span = (
                (min(low - 0.3, -self._half), max(high + 0.3, self._half))
                if gantry or carrier == "base"
                else (low - 0.3, high + 0.3)
            )
            for z in (at[2] - 0.14, at[2] + 0.14):
                self.box(carrier, (span[0], at[1] + 0.05, z - 0.02), (span[1], at[1] + 0.07, z + 0.02), "rail")
            self.box(carrier, (span[0], at[1] + 0.07, at[2] - 0.19), (span[1], at[1] + 0.27, at[2] + 0.19), "white")
            return at + _at(0.0, 0.07, -0.19 if gantry else 0.0)
        if "X" in inside:  # a gantry, or a beam that moves on two walls
            for sign in (-1.0, 1.0):
                foot = _at(sign * (self._half + 0.02), at[1], at[2])
                self.box(own, foot + _at(0.0, -0.1, -0.06), foot + _at(-sign * 0.14, 0.3, 0.0), "grey")
                wall, end = foot[0], foot[0] - sign * 0.14
                self.box(
                    carrier, (wall, at[1] + low - 0.15, self._floor), (end, at[1] + high + 0.4, at[2] - 0.065), "white"
                )
            return at
        back = at[1] + high + 0.1
        self.box(own, at - _at(0.15, 0.0, 0.15), _at(at[0] + 0.15, back + 0.35 - low, at[2] + 0.15), "grey")
        guide = _at(at[0], back, at[2])
        self.box(carrier, guide - _at(0.22, 0.0, 0.24), guide + _at(0.22, 0.3, -0.155), "white")
        for sign in (-1.0, 1.0):
            self.box(carrier, guide + _at(sign * 0.155, 0.0, -0.2), guide + _at(sign * 0.23, 0.3, 0.18), "white")
        return guide - _at(0.0, 0.0, 0.24 if carrier != "base" else -0.1)

    # --- Elements of the URDF ------------------------------------------------------------------------

    def lines(self, link: Placed) -> list[str]:
        """Return the lines of a link's shapes and, if an axis moves it, of its estimated mass."""
        visuals, masses = [], []
        for kind, size, turn, centre, colour in self._found.get(link.name, []):
            turned = link.rotation.T @ self._upright.T @ turn
            place = link.rotation.T @ (self._upright.T @ centre - link.origin - link.shift)
            shape = (
                f'box size="{_short(size)}"'
                if kind == "box"
                else f'cylinder radius="{size[0]:.5g}" length="{size[2]:.5g}"'
            )
            rpy = "" if np.allclose(turned, np.eye(3)) else f' rpy="{_short(rpy_of(turned), 8)}"'
            visuals.append(
                f'    <visual><origin xyz="{_short(place)}"{rpy}/><geometry><{shape}/></geometry><material name="{colour}"/></visual>'
            )
            outline = size if kind == "box" else size * [2.0, 2.0, 1.0]
            masses.append((DENSITY * float(np.prod(outline)), outline, turned, place))
        return ([_inertial(masses)] if masses and link.name != "base" else []) + visuals


def _at(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    return np.array([x, y, z], dtype=float)


def from_z(direction: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) that turns z to a unit vector, by roll and pitch."""
    x, y, z = direction
    return rotation_of((math.atan2(-y, math.hypot(x, z)), math.atan2(x, z), 0.0))


def rotation_of(rpy: Sequence[float]) -> np.ndarray:
    """Return the rotation (3, 3) by roll, pitch and yaw about the fixed x, y and z (URDF)."""
    (a, b, c), (d, e, f) = map(np.cos, rpy), map(np.sin, rpy)
    x = (c * b, c * e * d - f * a, c * e * a + f * d)
    return np.array([x, (f * b, f * e * d + c * a, f * e * a - c * d), (-e, b * d, b * a)])


def rpy_of(rotation: np.ndarray) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a rotation; yaw is zero where the pitch is a right angle."""
    r = rotation
    across = math.hypot(r[2, 1], r[2, 2])
    if across < 1e-12:
        return math.atan2(-r[1, 2], r[1, 1]), math.atan2(-r[2, 0], across), 0.0
    return math.atan2(r[2, 1], r[2, 2]), math.atan2(-r[2, 0], across), math.atan2(r[1, 0], r[0, 0])


def _inertial(masses: Sequence[tuple[float, np.ndarray, np.ndarray, np.ndarray]]) -> str:
    """Return the element of the mass of boxes: (kg, sizes, orientation, centre) each."""
    total = sum(mass for mass, *_ in masses)
    centre = np.sum([mass * place for mass, _, _, place in masses], axis=0) / total
    inertia = np.zeros((3, 3))
    for mass, size, turn, place in masses:
        squares, away = size**2, place - centre
        inertia += turn @ np.diag(mass / 12.0 * (squares.sum() - squares)) @ turn.T
        inertia += mass * (away @ away * np.eye(3) - np.outer(away, away))
    parts = (("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2))
    texts = " ".join(f'{name}="{inertia[i, j]:.4g}"' for name, i, j in parts)
    return f'    <inertial><origin xyz="{_short(centre)}"/><mass value="{total:.4g}"/><inertia {texts}/></inertial>'


def _short(values: Sequence[float] | np.ndarray, digits: int = 5) -> str:
    return " ".join(f"{round(float(value), digits) + 0.0:g}" for value in values)
