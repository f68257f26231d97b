"""Machines of other kinds than the DMU 50 for the control: machine files, and what they do in plain numpy, by no code of twin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import twin
from tests.real import write_both
from tests.truth.any_chain import rotations
from tests.truth.machine import TruthMachine

UM, URAD = 1e-3, 1e-6


@dataclass(frozen=True)
class Part:
    """One axis of a side, from the base outwards; its frame is parallel to that of the base.

    Attributes:
        name: its word.
        motion: (3,) direction of a positive command: along it, or about it.
        place: (3,) origin on the part before, mm.
        low, high: its range, mm or degrees; that of an endless axis ends after a turn.
    """

    name: str
    motion: tuple[float, float, float]
    low: float
    high: float
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def linear(self) -> bool:
        return self.name in "XYZ"


@dataclass(frozen=True)
class Kind:
    """A machine of two serial chains from the same base, with its nominal and its true tool pose.

    Attributes:
        nose: (3,) spindle nose on the last part of the tool side, mm.
        bundled: name of its machine file, if that comes with twin.
        increment: least increment of its words, mm and degrees, if it does not.
    """

    tool: tuple[Part, ...]
    work: tuple[Part, ...] = ()
    nose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bundled: str = ""
    increment: float = 0.001

    def machine(self, folder: Path) -> twin.Machine:
        """Return the machine, its files written into a folder."""
        if self.bundled:
            return twin.Machine.load(self.bundled)
        joints, axes = [], []
        for side, parts in (("tool", self.tool), ("work", self.work)):
            parent = "base"
            for part in parts:
                joints.append(_joint(part, parent))
                parent = f"link_{part.name}"
            end = self.nose if side == "tool" else (0.0, 0.0, 0.0)
            joints.append(
                f'<joint name="{side}_end" type="fixed"><parent link="{parent}"/><child link="{side}"/>'
                f'<origin xyz="{_metres(end)}"/></joint><link name="{side}"/>'
            )
        for part in sorted((*self.tool, *self.work), key=lambda one: (not one.linear, one.name)):
            kind = "linear" if part.linear else "rotary"
            axes.append(
                f"  - {{name: {part.name}, joint: joint_{part.name}, kind: {kind}, range: [{part.low}, {part.high}], "
                f"increment: {self.increment}}}"
            )
        urdf = f'<?xml version="1.0"?>\n<robot name="kind"><link name="base"/>\n{"".join(joints)}</robot>\n'
        file = "schema: twin.machine/1\nname: kind\nurdf: kind.urdf\naxes:\n" + "\n".join(axes)
        return twin.Machine.load(write_both(folder, "kind", urdf, file + "\nframes: {tool: tool, work: work}\n"))

    def tip(
        self, names: tuple[str, ...], q: np.ndarray, tool: tuple[float, float, float], truth: TruthMachine | None = None
    ) -> np.ndarray:
        """Return (n, 3) the tool tip on the workpiece, mm, at commands (n, axes) in mm and degrees; without ``truth``: nominal.

        ``tool``: offsets as a tool table holds them, mm: the tip is behind the spindle nose by them.
        """
        point = np.tile(np.array(self.nose) - tool, (len(q), 1))
        for part in reversed(self.tool):
            turn, shift = self._pose(part, q[:, names.index(part.name)], truth)
            point = np.einsum("nij,nj->ni", turn, point) + shift
        for part in self.work:
            turn, shift = self._pose(part, q[:, names.index(part.name)], truth)
            point = np.einsum("nji,nj->ni", turn, point - shift)
        return point

    def axes(self, names: tuple[str, ...], words: np.ndarray, tool: tuple[float, float, float]) -> np.ndarray:
        """Return (n, axes) where the axes of the nominal machine stand at words in coordinates of the workpiece (n, axes).

        X, Y and Z name the point that the tip reaches at these positions of the linear axes with all rotary axes at zero.
        """
        return self._moved(names, self.tip(names, _at_zero(names, words, linear=False), tool), words, tool)

    def words(self, names: tuple[str, ...], q: np.ndarray, tool: tuple[float, float, float]) -> np.ndarray:
        """Return (n, axes) the words in coordinates of the workpiece of positions (n, axes): the inverse of `axes`."""
        rest = self._moved(names, self.tip(names, q, tool), _at_zero(names, q, linear=False), tool)
        return np.where([name in "XYZ" for name in names], rest, q)

    def _moved(
        self, names: tuple[str, ...], goal: np.ndarray, q: np.ndarray, tool: tuple[float, float, float]
    ) -> np.ndarray:
        """Return positions (n, axes) with the rotary axes of ``q`` at which the tip is at ``goal``: it is linear in X, Y and Z."""
        found = _at_zero(names, q, linear=True)
        columns = [names.index(name) for name in "XYZ"]
        start = self.tip(names, found, tool)
        units = np.eye(len(names))[columns]
        by = np.stack([self.tip(names, found + unit, tool) - start for unit in units], axis=2)
        found[:, columns] = np.linalg.solve(by, (goal - start)[:, :, None])[:, :, 0]
        return found

    @staticmethod
    def _pose(part: Part, q: np.ndarray, truth: TruthMachine | None) -> tuple[np.ndarray, np.ndarray]:
        """Return rotations (n, 3, 3) and shifts (n, 3) of a part on the one before."""
        motion = np.array(part.motion) / np.linalg.norm(part.motion)
        error, located = np.zeros((len(q), 6)), np.zeros((1, 6))
        if truth is not None:
            error = np.stack([truth.curve(f"E_{letter}{part.name}", q) + 0.0 * q for letter in "XYZABC"], axis=1)
            located = np.array([[truth.location.get(f"E_{letter}0{part.name}", 0.0) for letter in "XYZABC"]])
            for letter, about in zip("ABC", np.eye(3), strict=True):
                angle = truth.squareness.get(f"E_{letter}0{part.name}", 0.0) if part.linear else 0.0
                # An angle of 1 µrad is 0.001 µm per mm.
                error[:, :3] += UM * angle * q[:, None] * np.cross(about, motion)
        turn, shift = rotations(URAD * error[:, 3:]), UM * error[:, :3]
        if part.linear:
            return turn, np.array(part.place) + q[:, None] * motion + shift
        outer = rotations(URAD * located[:, 3:])[0]
        return outer @ turn @ rotations(np.radians(q)[:, None] * motion), part.place + UM * located[
            0, :3
        ] + shift @ outer.T


def _at_zero(names: tuple[str, ...], q: np.ndarray, *, linear: bool) -> np.ndarray:
    """Return positions with the linear axes, or all others, at zero."""
    return np.where([(name in "XYZ") == linear for name in names], 0.0, q)


def _metres(place: tuple[float, ...]) -> str:
    return " ".join(repr(1e-3 * value) for value in place)


def _joint(part: Part, parent: str) -> str:
    kind = "prismatic" if part.linear else "revolute"
    return (
        f'<joint name="joint_{part.name}" type="{kind}"><parent link="{parent}"/><child link="link_{part.name}"/>'
        f'<origin xyz="{_metres(part.place)}"/><axis xyz="{" ".join(map(repr, part.motion))}"/>'
        f'<limit lower="-10" upper="10" effort="0" velocity="1"/></joint><link name="link_{part.name}"/>\n'
    )


_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_BACK_X, _BACK_Y, _BACK_Z = (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)
_SLIDES = (Part("X", _X, 0.0, 600.0), Part("Y", _Y, 0.0, 500.0), Part("Z", _Z, -450.0, 0.0, (0.0, 0.0, 700.0)))

KINDS: dict[str, Callable[[], Kind]] = {
    "head-head": lambda: Kind(
        (
            *_SLIDES,
            Part("C", _Z, -200.0, 200.0, (3.0, -2.0, -150.0)),
            Part("A", _X, -110.0, 110.0, (0.0, 4.0, -120.0)),
        ),
        nose=(0.5, -0.3, -160.0),
    ),
    "head-table": lambda: Kind(
        (
            Part("Y", _Y, 0.0, 500.0),
            Part("Z", _Z, -450.0, 0.0, (0.0, 0.0, 700.0)),
            Part("B", _Y, -100.0, 100.0, (2.0, 0.0, -50.0)),
        ),
        (Part("X", _BACK_X, 0.0, 600.0), Part("C", _BACK_Z, -360.0, 360.0, (-10.0, 240.0, 80.0))),
        nose=(0.0, 0.0, -180.0),
    ),
    "nutating head and table": lambda: Kind(
        (*_SLIDES, Part("B", (0.0, 1.0, 1.0), -90.0, 180.0, (0.0, 30.0, -40.0))),
        (Part("C", _BACK_Z, -360.0, 360.0, (300.0, 250.0, 50.0)),),
        nose=(0.0, -30.0, -140.0),
    ),
    "trunnion": lambda: Kind(
        # Each side starts where its linear joints are at zero: X 300, Y 250, Z -450.
        (Part("X", _X, 0.0, 600.0, (-300.0, 0.0, 450.0)), Part("Z", _Z, -450.0, 0.0)),
        (
            Part("Y", _BACK_Y, 0.0, 500.0, (0.0, 250.0, 0.0)),
            Part("A", _BACK_X, -120.0, 30.0, (0.0, 0.0, 60.0)),
            Part("C", _BACK_Z, 0.0, 360.0, (0.0, 0.0, -60.0)),
        ),
        bundled="trunnion_ac",
    ),
    "four axes": lambda: Kind(
        (Part("Z", _Z, -450.0, 0.0, (0.0, 0.0, 700.0)),),
        (
            Part("X", _BACK_X, 0.0, 600.0),
            Part("Y", _BACK_Y, 0.0, 500.0),
            Part("A", _BACK_X, -360.0, 360.0, (150.0, 20.0, 120.0)),
        ),
    ),
    "three axes": lambda: Kind(
        (Part("X", _X, 0.0, 600.0), Part("Z", _Z, -450.0, 0.0, (0.0, 0.0, 700.0))),
        (Part("Y", _BACK_Y, 0.0, 500.0),),
    ),
}
