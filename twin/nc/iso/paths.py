"""End points about a pole, by an angle or through a point, and paths that the control shapes (SINUMERIK)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from twin.nc.arcs import (
    ABSOLUTE,
    CIRCLE_MM,
    FROM_START,
    PLANES,
    CentreWords,
    arc_by_angle,
    arc_by_centre,
    arc_through,
    turned_about,
)
from twin.nc.blocks import Arc
from twin.nc.iso import vocabulary
from twin.nc.iso.frame import IsoBlock, IsoShift, Item
from twin.nc.modal import Span
from twin.nc.text import MM_PER_INCH

CENTRE: Final = {"I": 0, "J": 1, "K": 2}
FORMS: Final[Mapping[str, CentreWords]] = {"AC": ABSOLUTE}
"""Forms of a centre of SINUMERIK, ``I=AC(…)``; all others count from the start."""


class IsoPaths(IsoShift):
    """End points of SINUMERIK about a pole, by an angle or through a point, and paths that the control shapes.

    Source: SINUMERIK 840D sl, Programming Manual Fundamentals, chapter "Motion commands" (``G110`` to ``G112``, ``AP=``, ``RP=``,
    ``ANG=``, ``AR=``, ``CIP``, ``CT``, splines).

    Attributes:
        curve: ``CIP``, ``CT`` or a spline in force in place of a motion code, empty for none.
        rounded: whether every corner is rounded (``RNDM``).
    """

    curve = ""
    rounded = False
    _pole: tuple[tuple[float, float], object] | None = None
    _polar: tuple[float, float, tuple[float, float]] = math.nan, math.nan, (math.nan, math.nan)
    """Radius and angle of the last end point about the pole, and that point."""

    def _frame_of_pole(self) -> object:
        return self.plane, self.frame.shift, self.frame.turn, self.frame.plane, self.offset

    def set_pole(self, block: IsoBlock) -> None:
        """Apply ``G110`` (from the last position), ``G111`` (from zero) or ``G112`` (from the pole before) and take their words."""
        code, (a, b, _) = block.codes[0].name, PLANES[self.plane]
        values = {item.name: self._length_or_angle(item) for item in (*block.items, *block.others)}
        names = {self.names[a], self.names[b]}
        other = len(block.codes) > 1 or block.names or block.m_words or block.feed is not None
        if other or not (values.keys() <= names or values.keys() == {"AP", "RP"}) or self.incremental:
            raise self.error(f"G{code} with other words, or in G91", f"G{code} with X and Y, or AP= and RP=")
        from_ = (0.0, 0.0)
        if code != "111":
            from_ = self._pole_in_force() if code == "112" else (self.position[a], self.position[b])
        if "AP" in values:
            by = turned_about((0.0, 0.0), (values["RP"], 0.0), values["AP"])
        else:
            by = values.get(self.names[a], 0.0), values.get(self.names[b], 0.0)
        self._pole = (from_[0] + by[0], from_[1] + by[1]), self._frame_of_pole()
        self.check_pole()
        block.items, block.others = [], []

    def check_pole(self) -> None:
        """Raise `InputError` for a pole in a program with words of another control, where its word selects a work offset."""
        if self._pole is not None and self.without_frames:
            what = "G110, G111 or G112 in a program with words of Fanuc or Haas, where it selects a work offset or a lathe's mode"
            raise self.error(what, "a program of SINUMERIK, or G154 P with the number of the work offset")

    def _pole_in_force(self) -> tuple[float, float]:
        if self._pole is None:
            return 0.0, 0.0
        if self._pole[1] != self._frame_of_pole():
            raise self.error("pole from before a change of the coordinates or of the plane", "G110, G111 or G112 again")
        return self._pole[0]

    def _length_or_angle(self, item: Item) -> float:
        value = self.known_value(item.name, item.value, "a number")
        return value * (MM_PER_INCH if self.inch and item.name not in ("AP", "AR", "ANG") else 1.0)

    def path_words(self, items: list[Item]) -> tuple[dict[str, Item], list[Item]]:
        """Return the words in place of an end point or a centre, by name, and the others."""
        path = {item.name: item for item in items if item.name in vocabulary.PATH_WORDS}
        return path, [item for item in items if item.name not in path] if path else items

    def named_by_path(self, path: Mapping[str, Item]) -> frozenset[str]:
        """Return the axes that such words name."""
        return frozenset(self.names[axis] for axis in PLANES[self.plane][:2] if path)

    def go_to_end(self, block: IsoBlock, path: Mapping[str, Item], start: list[float]) -> tuple[float, float] | None:
        """Set the end point of a block from words in place of it; return the pole if they are about one."""
        a, b, _ = PLANES[self.plane]
        here = start[a], start[b]
        if not path:
            return None
        block.path_words += [Span(item.start, item.end, item.name) for item in path.values()]
        given = [axis for axis in (a, b) if block.axis_bits >> axis & 1]
        end: tuple[float, float] = self.position[a], self.position[b]
        about = None
        if path.keys() & {"AP", "RP"}:
            if given or self.incremental or not path.keys() <= {"AP", "RP"}:
                raise self.error("end point about a pole with other words of the plane, or in G91", "AP= and RP=")
            about = self._pole_in_force()
            end = self._about_pole(path, about, here)
        elif path.keys() == {"ANG"} and self.motion == 1:
            end = self._along(given, self._length_or_angle(path["ANG"]), here, end)
        elif not (
            path.keys() <= {"I1", "J1", "K1"} if self.curve == "CIP" else path.keys() == {"AR"} and self.motion != 1
        ):
            raise self.error(f"{next(iter(path))} in this block", "AR= with G2 or G3, ANG= with G1, I1= J1= with CIP")
        if not all(map(math.isfinite, end)):
            raise self.error("end point from an unknown position", "a position of both axes before it")
        self.position[a], self.position[b] = end
        return about

    def _about_pole(
        self, path: Mapping[str, Item], pole: tuple[float, float], here: tuple[float, float]
    ) -> tuple[float, float]:
        radius, angle, at = self._polar
        kept = math.dist(at, here) <= 1e-9
        if "AP" in path:
            item = path["AP"]
            wrapped = vocabulary.WRAPPED.fullmatch(item.value)
            value = self._length_or_angle(item if wrapped is None else item._replace(value=wrapped[2]))
            by = wrapped is not None and wrapped[1].upper() == "IC"
            angle = value + (angle if kept else math.nan) if by else value
        else:
            angle = angle if kept else math.nan
        radius = self._length_or_angle(path["RP"]) if "RP" in path else radius if kept else math.nan
        if radius != radius or angle != angle:
            raise self.error(
                "AP= or RP= without the other one", "both, or one of them right behind a block about the pole"
            )
        end = turned_about(pole, (pole[0] + radius, pole[1]), angle)
        self._polar = radius, angle, end
        return end

    def _along(
        self, given: list[int], angle: float, here: tuple[float, float], end: tuple[float, float]
    ) -> tuple[float, float]:
        """Return the end of a line by its direction and one coordinate."""
        c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        if len(given) != 1 or abs(c if given[0] == PLANES[self.plane][0] else s) < 1e-9:
            raise self.error("ANG= without one coordinate of the plane", "ANG= and X, or ANG= and Y, not across it")
        if given[0] == PLANES[self.plane][0]:
            return end[0], here[1] + (end[0] - here[0]) * s / c
        return here[0] + (end[1] - here[1]) * c / s, end[1]

    def arc_of_path(
        self,
        block: IsoBlock,
        path: Mapping[str, Item],
        about: tuple[float, float] | None,
        start: list[float],
        centre: list[Item],
    ) -> Arc | None:
        """Return the arc of a block with words in place of its end, centre or radius; None: by its centre or radius."""
        if not (path or self.curve):
            return None
        a, b, third = plane = PLANES[self.plane]
        from_, to = (start[a], start[b]), (self.position[a], self.position[b])
        if self.curve == "CIP":
            points = [start[axis] for axis in plane]
            for i, axis in enumerate(plane):
                item = path.get(f"{'IJK'[axis]}1")
                if item is not None:
                    wrapped = vocabulary.WRAPPED.fullmatch(item.value)
                    value = self._length_or_angle(item if wrapped is None else item._replace(value=wrapped[2]))
                    by = self.incremental if wrapped is None else wrapped[1].upper() == "IC"
                    points[i] = value + (points[i] if by else 0.0)
            if max(abs(points[2] - start[third]), abs(self.position[third] - start[third])) > 1e-9 or centre:
                raise self.error("circle in space by CIP", "a circle in the plane, or the path as straight blocks")
            return self.valid_arc(arc_through(plane, from_, (points[0], points[1]), to))
        if about is not None and not centre:
            return self.valid_arc(arc_by_centre(plane, from_, to, about, self.motion == 2))
        if path.keys() == {"AR"} and not centre:
            return self.valid_arc(arc_by_angle(plane, from_, to, self._length_or_angle(path["AR"]), self.motion == 2))
        if path.keys() == {"AR"} and not block.axis_bits & (1 << a | 1 << b):
            return self._arc_about(block, self._length_or_angle(path["AR"]), from_, centre)
        if path:
            raise self.error("arc by words that determine it twice", "AR= with a centre or with an end point")
        return None

    def _arc_about(self, block: IsoBlock, angle: float, start: tuple[float, float], centre: list[Item]) -> Arc:
        """Return the arc about a centre by its opening angle, and set its end point."""
        a, b, _ = plane = PLANES[self.plane]
        middle = [*start]
        for item in centre:
            axis = CENTRE.get(item.name, -1)
            if axis not in (a, b) or not 0.0 < angle < 360.0:
                raise self.error(
                    "arc by AR= with other words", "a centre in the plane, an angle between 0 and 360 degrees"
                )
            wrapped = vocabulary.WRAPPED.fullmatch(item.value)
            value = self._length_or_angle(item if wrapped is None else item._replace(value=wrapped[2]))
            form = FROM_START if wrapped is None else FORMS.get(wrapped[1].upper(), FROM_START)
            place = (a, b).index(axis)
            middle[place] = form.centre(start[place], value)
            block.path_words.append(Span(item.start, item.end, item.name))
        turn = -angle if self.motion == 2 else angle
        self.position[a], self.position[b] = turned_about((middle[0], middle[1]), start, turn)
        if not math.dist(middle, start) > CIRCLE_MM:
            raise self.error("arc of radius zero, or from an unknown position", "a centre apart from the start")
        return Arc(plane, (middle[0], middle[1]), math.radians(turn))

    def shape_paths(self, block: IsoBlock) -> None:
        """Leave the path of a block that moves to the control, where it shapes it."""
        if block.moves and self.curve in vocabulary.SHAPED:
            if block.motion_word is not None:
                self.shape_corner(self.curve, self._line, both=False)
            self.shape_corner(self.curve, self._line + 1, both=self.curve != "CT")
        if block.moves and self.rounded:
            self.shape_corner("RNDM", self._line + 1, both=True)

    def select_curve(self, block: IsoBlock, item: Item) -> None:
        """Put a path of SINUMERIK in force in place of a motion code; raise `InputError` for one that is not followed."""
        if item.name not in vocabulary.SHAPED | {"CIP"}:
            raise self.error(f"curve or rounding {item.name}", vocabulary.LINEAR)
        if block.motion_word is not None or self.cycle is not None or self.code:
            raise self.error(f"{item.name} with a motion word, or in a cycle", f"{item.name} alone")
        self.motion, self.curve = 2 if item.name == "CIP" else 1, item.name
        block.motion_word = Span(item.start, item.end, item.name)

    def shapes(self, block: IsoBlock, name: str, value: str) -> bool:
        """Apply a word that rounds corners or belongs to a spline; return whether it is one."""
        if name in vocabulary.CORNERS:
            self.shape_corner(name, self._line + 1, both=True)
            return True
        if name == "RNDM":
            self.rounded = self.value_of(value) != 0.0
            return True
        in_force = {self.curve, *(one.name for one in block.names)}
        return name in vocabulary.SPLINE_WORDS and bool(in_force & vocabulary.SPLINES)

    def check_assigned(self, name: str, shown: str) -> None:
        """Raise `InputError` for an assignment that changes the meaning of axis words in a way that is not followed."""
        if name[0] in "ABCD" and name[1:] in ("2", "6", "7"):
            raise self.error(f"tool orientation by {name}", "a tool vector A3= B3= C3=, or rotary axes", shown)
        if name in vocabulary.CURVES:
            raise self.error(f"curve or rounding {name}", vocabulary.LINEAR, shown)
        if name in vocabulary.TRANSFORMS or name.startswith("$P_"):
            raise self.error(f"coordinate transformation {name}", vocabulary.NO_TRANSFORMATION, shown)
