"""Compensation by the method of Ellingsdalen (2021), listings 3.1-3.4 as they run: a baseline for comparison.

The method subtracts the deviation once and does not invert the kinematics. The properties of the listings are reproduced, mistakes
included, because the published figure 3.11 was made with them:

- a fitted polynomial of degree above one loses its constant (listing 3.1);
- curves are read at the nearest whole mm or degree; Z's table is indexed from its far end (listings 3.3, 3.4);
- angular errors of the linear axes are omitted (eq. 3.40);
- E_BB is read for E_CB and E_BC for E_CC, the rotation about y has the wrong sign, and the errors of both rotary axes stand before
  the whole chain instead of at their joints (listing 3.3);
- axis locations are not included.
"""

from __future__ import annotations

from typing import final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import URAD
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.motion_curve import Curve


@final
class ThesisMethod:
    """The thesis's compensation, for a machine with X, Y, Z on the tool side and two rotary axes under the workpiece.

    Args:
        calibration: the identified error motions.
        nominal: the machine without errors.

    Raises:
        InputError: a machine of another design, which the listings do not cover.
    """

    def __init__(self, calibration: Calibration, nominal: Kinematics) -> None:
        machine = calibration.machine
        sides = {axis.name: axis.side for axis in machine.axes}
        linear = tuple(machine.axes[i].name for i in machine.linear)
        if linear != ("X", "Y", "Z") or any(sides[name] != "tool" for name in linear):
            raise InputError(
                "the method of the thesis needs X, Y, Z on the tool side",
                expected="the method exact for this machine",
                value=machine.name,
                setting="method",
            )
        self._calibration = calibration
        self._nominal = nominal
        self._linear = list(machine.linear)
        self._rotary = list(machine.rotary)

    def commands(self, nominal: np.ndarray) -> np.ndarray:
        """Return compensated commands (n, axes), mm and degrees, for nominal ones: rotary axes first, then linear (figure 3.9)."""
        commands = np.array(nominal, dtype=float)
        commands[:, self._linear] += self._for_rotary(nominal)
        commands[:, self._linear] -= self._of_linear(commands)
        return commands

    def _for_rotary(self, q: np.ndarray) -> np.ndarray:
        """Return (n, 3) mm by which the linear axes follow the workpiece: listing 3.3, with the errors before the whole chain."""
        shift = np.zeros((len(q), 3))
        turned = np.broadcast_to(np.eye(3), (len(q), 3, 3))
        for i in self._rotary:
            for k, read in enumerate("ABB"):  # E_B is read for E_C
                turned = turned @ _turn(k, self._read(f"E_{read}", i, q) * URAD)
            shift += self._translation_mm(i, q)
        # The workpiece point under the tool is where the tool is meant to be; the work frame at rest is the base frame.
        upright = np.array(q)
        upright[:, self._rotary] = 0.0
        point = self._nominal.forward(upright).point_mm
        return np.asarray(np.einsum("nij,nj->ni", turned, point + shift) - point)

    def _of_linear(self, q: np.ndarray) -> np.ndarray:
        """Return the (n, 3) deviation in mm of the linear axes: eq. 3.40 and listing 3.4, translations and squareness only."""
        _, y, z = (q[:, i] for i in self._linear)
        square = self._calibration.squareness
        deviation = sum((self._translation_mm(i, q) for i in self._linear), start=np.zeros((len(q), 3)))
        deviation[:, 0] += (-y * square.get("E_C0Y", 0.0) + z * square.get("E_B0Z", 0.0)) * 1e-6
        deviation[:, 1] += -z * square.get("E_A0Z", 0.0) * 1e-6
        return deviation

    def _translation_mm(self, axis: int, q: np.ndarray) -> np.ndarray:
        """Return the (n, 3) translational errors of an axis in mm."""
        return np.stack([self._read(f"E_{d}", axis, q) * 1e-3 for d in "XYZ"], axis=1)

    def _read(self, component: str, axis: int, q: np.ndarray) -> np.ndarray:
        """Return an axis's curve as the listings read it: without its constant, at the nearest whole mm or degree."""
        name = self._calibration.machine.axes[axis].name
        curve: Curve | None = self._calibration.curves.get(component + name)
        if curve is None:
            return np.zeros(len(q))
        lo, hi = curve.domain
        whole = np.round(q[:, axis])
        if lo < 0.0 <= hi:
            # The table runs from 0 down to lo; a negative index counts from its end.
            whole = np.where(whole < 0.0, lo - 1.0 - whole, whole)
        elif self._calibration.machine.by_name[name].lower is None:
            whole = lo + np.mod(whole - lo, hi - lo)
        values = curve(np.clip(whole, lo, hi))
        at_zero = curve(np.clip(0.0, lo, hi))
        return np.asarray(values - at_zero if len(curve.coefficients) > 2 else values)


def _turn(about: int, angles: np.ndarray) -> np.ndarray:
    """Return (n, 3, 3) rotations about x, y or z as the listing writes them: the sign of that about y is reversed."""
    i, j = ((1, 2), (0, 2), (0, 1))[about]
    turns = np.zeros((len(angles), 3, 3))
    turns[:, range(3), range(3)] = 1.0
    turns[:, i, i] = turns[:, j, j] = np.cos(angles)
    turns[:, i, j], turns[:, j, i] = -np.sin(angles), np.sin(angles)
    return turns
