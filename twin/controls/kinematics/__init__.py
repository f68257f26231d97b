"""Kinematics of a control's five-axis transformation, one format a file.

To add one, write its file and add it to `twin._common.families.KINEMATICS_FORMATS`. They act only while the transformation is active
(tool centre point mode).
"""

from __future__ import annotations

from functools import cache

from twin._common import families
from twin._common.errors import InputError
from twin.controls.kinematics.format import KinematicsFormat


def kinematics_formats() -> tuple[KinematicsFormat, ...]:
    """Return all formats."""
    return tuple(map(kinematics_named, families.KINEMATICS_FORMATS))


@cache
def kinematics_named(name: str) -> KinematicsFormat:
    """Return the format of that name, without importing the others; raise `InputError` if there is none."""
    if name not in families.KINEMATICS_FORMATS:
        expected = f"one of {' '.join(families.KINEMATICS_FORMATS)}"
        raise InputError("no such format of control kinematics", expected=expected, value=name)
    form: KinematicsFormat = families.member(__name__, families.KINEMATICS_FORMATS, name)
    return form
