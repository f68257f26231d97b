"""Kinematics of a control's five-axis transformation, one format a file; to add one, write its file and add it to `KINEMATICS`.

They act only while the transformation is active (tool centre point mode).
"""

from __future__ import annotations

from typing import Final

from twin._common.errors import InputError
from twin.machine.control.kinematics.fanuc import FanucTable
from twin.machine.control.kinematics.format import KinematicsFormat
from twin.machine.control.kinematics.geometry import KinematicCorrection, TableGeometry, linear_shift, table_geometry
from twin.machine.control.kinematics.heidenhain_table import HeidenhainTable
from twin.machine.control.kinematics.linuxcnc_trt import LinuxCncTrt
from twin.machine.control.kinematics.siemens_chain import SiemensChain
from twin.machine.control.kinematics.siemens_trafo5 import SiemensTrafo5

__all__ = [
    "KINEMATICS",
    "KinematicCorrection",
    "KinematicsFormat",
    "TableGeometry",
    "kinematics_named",
    "linear_shift",
    "table_geometry",
]

KINEMATICS: Final[tuple[KinematicsFormat, ...]] = (
    LinuxCncTrt(),
    SiemensChain(),
    SiemensTrafo5(),
    HeidenhainTable(),
    FanucTable(),
)
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
