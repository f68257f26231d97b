"""A machine's URDF with the constant geometric errors of a calibration: other programs then use the real positions of its axes.

A URDF holds where joints are and in which direction they move, and nothing that depends on a position. Squareness, axis locations and
zero offsets are therefore part of it; curves, reversals and every other effect are not, and are listed.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import casadi as ca
import numpy as np
import pinocchio as pin

from twin._common.errors import InputError
from twin._common.files import write_atomic
from twin._common.provenance import warning_texts
from twin._common.units import MM
from twin.display.results import Result
from twin.machine.machine import Axis, Machine
from twin.machine.machine_file import read_urdf
from twin.model.calibration import Calibration
from twin.model.effects import Effect
from twin.model.unknown_errors import error_vector
from twin.numerics.spatial import rotation_exp

_PROBES: Final = 7
"""Number of positions over an axis's range at which an effect is evaluated to see whether a URDF can contain it."""
_NOTHING: Final = 1e-13
"""Largest rounding error of an evaluated effect, m or rad."""


@final
@dataclass(frozen=True, repr=False)
class CalibratedUrdf(Result):
    """A URDF with constant geometric errors."""

    text: str
    included: tuple[str, ...]  # names of the errors that it contains
    left_out: tuple[str, ...]  # names of the errors that a URDF cannot contain
    path: Path  # the machine's own URDF

    @property
    def brief(self) -> str:
        """Sentence on what the file contains."""
        without = f"; without {', '.join(self.left_out)}, which a URDF cannot contain" if self.left_out else ""
        return f"the URDF contains {', '.join(self.included) or 'no errors'}{without}"

    def save(self, path: str | Path) -> None:
        """Write the file atomically, after it was read back; meshes are named relative to it."""
        folder = Path(path).resolve().parent
        robot = _parsed(self.text)
        for mesh in robot.iter("mesh"):
            name = mesh.get("filename", "")
            if "://" not in name and not Path(name).is_absolute():
                mesh.set("filename", os.path.relpath(self.path.resolve().parent / name, folder))
        write_atomic(Path(path), _printed(robot), check=read_urdf)


def calibrated_urdf(calibration: Calibration) -> CalibratedUrdf:
    """Return a machine's URDF in which joints have the places and directions that a calibration found.

    The joints' positions mean the same as before. A linear axis gets its real direction, a rotary axis the place and orientation of its
    average line.

    Raises:
        InputError: the URDF cannot be read.

    Examples:
        >>> from dataclasses import replace
        >>> machine = twin.Machine.load("dmu50")
        >>> calibration = replace(twin.Calibration.zero(machine), squareness={"E_C0Y": 20.0})
        >>> urdf = twin.calibrated_urdf(calibration)
        >>> urdf.included
        ('E_C0Y',)
        >>> urdf.save("calibrated.urdf")
    """
    machine = calibration.machine
    robot = _parsed(read_urdf(machine.urdf))
    joints = {joint.get("name"): joint for joint in robot.findall("joint")}
    included: list[Effect] = []
    left_out: list[Effect] = []
    for effect in calibration.effects:
        (included if _fits(effect, machine) else left_out).append(effect)
    for axis in machine.axes:
        own = tuple(effect for effect in included if effect.frame.axis == axis.name)
        if own:
            (_move_linear if axis.linear else _move_rotary)(joints[axis.joint], machine, axis, own)
    names = tuple(effect.name for effect in included)
    without = tuple(effect.name for effect in left_out)
    robot.insert(0, ET.Comment(_comment(calibration, names, without)))
    return CalibratedUrdf(_printed(robot), names, without, machine.urdf)


def _components(effects: tuple[Effect, ...], machine: Machine, axis: Axis, at: np.ndarray) -> dict[str, np.ndarray]:
    """Return by role the (n, 6) errors of an axis's frames with the axis at (n,) positions in mm or degrees, the others at zero."""
    q = ca.SX.sym("q")
    state = ca.SX(len(machine.axes), 1)
    state[machine.names.index(axis.name)] = q * axis.scale
    function = ca.Function("errors", [q], [error_vector(machine, effects, state)])
    found = np.stack([np.asarray(function(float(one))).reshape(-1, 6) for one in at], axis=1)
    return {frame.role: rows for frame, rows in zip(machine.frames, found, strict=True) if frame.axis == axis.name}


def _fits(effect: Effect, machine: Machine) -> bool:
    """Return whether a URDF can contain an effect: a constant, or a direction of a linear axis."""
    axis = machine.by_name[effect.frame.axis]
    share = np.linspace(0.0, 1.0, _PROBES)[:, None]
    low, high = axis.domain
    try:
        rows = _components((effect,), machine, axis, low + share[:, 0] * (high - low))[effect.frame.role]
    except InputError:  # it needs a channel
        return False
    if not axis.linear:
        return bool(np.allclose(rows, rows[0], rtol=0.0, atol=_NOTHING))
    change = rows[-1] - rows[0]
    straight = np.allclose(rows, rows[0] + share * change, rtol=0.0, atol=_NOTHING)
    along = change[:3] @ np.array(axis.direction)
    return bool(straight and abs(along) <= _NOTHING and np.all(np.abs(rows[:, 3:]) <= _NOTHING))


def _move_linear(joint: ET.Element, machine: Machine, axis: Axis, effects: tuple[Effect, ...]) -> None:
    """Give a linear joint its real direction, and the place at which it is at zero."""
    turn = machine.error_frame(axis.name).rotation
    start = machine.origin_mm.get(axis.name, 0.0)
    zero, one = _components(effects, machine, axis, np.array([start, start + 1.0]))["motion"]
    placement = _origin(joint) * pin.SE3(np.eye(3), turn @ zero[:3])
    direction = turn @ (np.array(axis.direction) + (one - zero)[:3] / MM)
    _set_origin(joint, placement)
    element = joint.find("axis")
    (ET.SubElement(joint, "axis") if element is None else element).set("xyz", _numbers(direction))


def _move_rotary(joint: ET.Element, machine: Machine, axis: Axis, effects: tuple[Effect, ...]) -> None:
    """Put a rotary joint where its average line is."""
    turn = machine.error_frame(axis.name)
    errors = _components(effects, machine, axis, np.zeros(1))
    error = pin.SE3.Identity()
    for role in ("location", "motion"):
        row = errors[role][0]
        error = error * pin.SE3(rotation_exp(row[3:]), row[:3])
    _set_origin(joint, _origin(joint) * turn * error * turn.inverse())


def _origin(joint: ET.Element) -> pin.SE3:
    element = joint.find("origin")
    xyz, rpy = (
        np.array([float(word) for word in ("" if element is None else element.get(name, "")).split()] or [0.0] * 3)
        for name in ("xyz", "rpy")
    )
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)


def _set_origin(joint: ET.Element, placement: pin.SE3) -> None:
    element = joint.find("origin")
    if element is None:
        element = ET.SubElement(joint, "origin")
    element.set("xyz", _numbers(placement.translation))
    element.set("rpy", _numbers(pin.rpy.matrixToRpy(placement.rotation)))


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.12g}" for value in np.where(np.abs(values) < 1e-15, 0.0, values))


def _comment(calibration: Calibration, included: Sequence[str], left_out: Sequence[str]) -> str:
    lines = [
        f"Made by twin from {calibration.machine.urdf.name} and a calibration: {calibration.source}.",
        *warning_texts(calibration.warnings),
        f"With these errors: {', '.join(included) or 'none'}.",
        f"Without these, which a URDF cannot contain: {', '.join(left_out) or 'none'}.",
    ]
    return " " + "\n     ".join(lines).replace("--", "- -") + " "


def _parsed(text: str) -> ET.Element:
    return ET.fromstring(text, parser=ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))


def _printed(robot: ET.Element) -> str:
    return f'<?xml version="1.0"?>\n{ET.tostring(robot, encoding="unicode")}\n'
