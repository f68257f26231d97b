"""Kinematics of a control's five-axis transformation, one format a file.

To add one, write its file and add it to `twin._common.families.KINEMATICS_FORMATS`. They act only while the transformation is active
(tool centre point mode).
"""

from __future__ import annotations

from typing import Final

from twin._common import families
from twin._common.errors import InputError
from twin.machine.control.kinematics.format import KinematicsFormat
from twin.machine.control.kinematics.geometry import KinematicCorrection, TableGeometry, linear_shift, table_geometry

__all__ = [
    "KINEMATICS",
    "KinematicCorrection",
    "KinematicsFormat",
    "TableGeometry",
    "kinematics_named",
    "linear_shift",
    "table_geometry",
]

KINEMATICS: Final[tuple[KinematicsFormat, ...]] = families.members(__name__, families.KINEMATICS_FORMATS)
"""All formats."""


def kinematics_named(name: str) -> KinematicsFormat:
    """Return the format of that name.

    Raises:
        InputError: there is no such format.
    """
    for form in KINEMATICS:
        if form.name == name:
            return form
    names = " ".join(form.name for form in KINEMATICS)
    raise InputError("no such format of control kinematics", expected=f"one of {names}", value=name)
