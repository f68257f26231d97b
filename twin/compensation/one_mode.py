"""Check that a program stays in one mode, if the control holds kinematics that act in tool centre point mode only."""

from __future__ import annotations

import numpy as np

from twin._common.errors import InputError
from twin.machine.calibration import Calibration


def check_one_mode(calibration: Calibration, modes: np.ndarray, source: str, *, tcp: bool) -> None:
    """Raise `InputError` if kinematics are held by the control and a program is not wholly in one mode.

    Args:
        calibration: the errors.
        modes: whether the words of each motion are tool-tip coordinates.
        source: name of the program.
        tcp: whether tool-centre-point mode is on from the start; the kinematics are taken into account if it is.
    """
    control = calibration.control
    if control is not None and control.kinematics and np.any(modes != tcp):
        raise InputError(
            "the kinematics of the control act in tool centre point mode only, and this program has motions in both modes, or in the "
            "other mode",
            expected="all motions in the mode that is chosen; split a program that switches the transformation between motions",
            file=source,
            setting="mode",
            value="tcp" if tcp else "axis",
        )
