"""Arcs, end points about the pole, and cutter radius compensation of Heidenhain programs.

Source: HEIDENHAIN TNC 640, user's manual Klartext programming, "Programming contours" (``CC``, ``LP``, ``CP``, ``RL``, ``RR``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from twin.nc.arcs import MOST_TURNS, ArcMisfit, arc_by_centre, arc_by_radius
from twin.nc.blocks import Arc
from twin.nc.heidenhain import vocabulary
from twin.nc.heidenhain.calls import PathBlock
from twin.nc.heidenhain.cycles import HeidenhainCycles
from twin.nc.modal import BESIDE, CORRECTION_DEG


class HeidenhainPaths(HeidenhainCycles):
    """Arcs, points about the pole and the side of the contour.

    Attributes:
        centre: the pole in force (``CC``), by axis.
        on_contour: whether the last block in the plane was compensated.
    """

    centre: Mapping[int, float] = {}
    on_contour = False

    def leave_contour(self) -> None:
        """Check that no radius compensation is selected where the control leaves the contour.

        Raises:
            InputError: it is.
        """
        if self.beside:
            raise self.error("machine coordinates under cutter radius compensation", "R0 before them")
        self.on_contour = False

    def compensated(self, block: PathBlock, rotary: list[float]) -> bool:
        """Return whether a block is under cutter radius compensation, or leads in or out; ``rotary``: the axes before it.

        Raises:
            InputError: it turns the tool, or calls a cycle.
        """
        if not (self.beside or self.on_contour or block.leads):
            return False
        here = self.position[self.linear :]
        turns = any(not abs(a - b) <= CORRECTION_DEG for a, b in zip(here, rotary, strict=True) if a == a or b == b)
        if self.tcp or self.vector is not None or block.normal is not None or turns or block.calls or self.modal:
            what = "cutter radius compensation with a tool that turns, or in a cycle"
            raise self.error(what, "the tool centre path (R0)")
        self.note(BESIDE, once=True)
        a, b, _ = self.plane
        if block.polar or block.axis_bits & (1 << a | 1 << b) or block.keyword in vocabulary.ARCS:
            self.on_contour = self.beside
        return True

    def polar_end(self, block: PathBlock, start: list[float]) -> float | None:
        """Set the end point of a block given about the pole, and return its sweep in radians if that is given.

        Raises:
            InputError: the pole, the start or the angle is unknown, or a word contradicts another.
        """
        a, b, _ = self.plane
        if not (a in self.centre and b in self.centre):
            raise self.error(f"{block.keyword} without a pole", "CC before it")
        if block.axis_bits & (1 << a | 1 << b) or (
            block.keyword == "CP" and ("R" in block.polar or "A" not in block.polar)
        ):
            expected = "CP with PA or IPA" if block.keyword == "CP" else "PR and PA without axis words of the plane"
            raise self.error(f"{block.keyword} with other words", expected)
        u, v = start[a] - self.centre[a], start[b] - self.centre[b]
        if math.hypot(u, v) < 1e-9 and (
            block.keyword == "CP" or block.polar.keys() != {"R", "A"} or block.polar["A"][1]
        ):
            raise self.error(f"{block.keyword} from the pole itself", "PR and PA")
        values = {"R": math.hypot(u, v), "A": math.degrees(math.atan2(v, u))}
        begin = math.radians(values["A"])
        for name, (value, incremental) in block.polar.items():
            values[name] = value + (values[name] if incremental else 0.0)
        if not all(map(math.isfinite, values.values())):
            raise self.error(f"{block.keyword} from an unknown position", "a position of both axes before it")
        angle = math.radians(values["A"])
        self.position[a] = self.centre[a] + values["R"] * math.cos(angle)
        self.position[b] = self.centre[b] + values["R"] * math.sin(angle)
        if block.keyword != "CP" or not block.polar["A"][1]:
            return None
        if block.clockwise is not None and (angle < begin) != block.clockwise:
            raise self.error("CP whose angle and sense differ", "IPA with the sign of DR")
        if abs(angle - begin) > math.radians(360.0 * MOST_TURNS):
            raise self.error("arc of too many turns", f"at most {MOST_TURNS} turns")
        return angle - begin

    def arc(self, block: PathBlock, start: list[float], sweep: float | None) -> Arc:
        """Return the arc of a block; ``sweep``: in radians, if the block gives it.

        Raises:
            InputError: it has no sense, no centre or radius, or is invalid.
        """
        if block.clockwise is None:
            raise self.error("circular block without its sense", "DR+ or DR-")
        a, b, _ = self.plane
        from_, to = (start[a], start[b]), (self.position[a], self.position[b])
        if block.keyword == "CR":
            if block.radius is None:
                raise self.error("CR without a radius", "R+10 or R-10")
            return self.valid_arc(arc_by_radius(self.plane, from_, to, block.radius, block.clockwise))
        if a in self.centre and b in self.centre:
            centre = (self.centre[a], self.centre[b])
            if sweep:
                return Arc(self.plane, centre, sweep)
            return self.valid_arc(arc_by_centre(self.plane, from_, to, centre, block.clockwise))
        return self.valid_arc(ArcMisfit("circular block without its centre", "CC before it"))
