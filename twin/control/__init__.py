"""Compensation tables of the machine's control: made from a calibration, read back, and taken into account for programs.

Manual: `twin doc control`.
"""

from twin.control.account import Account
from twin.control.deliver import account_of, outputs_of, write_folder, written_by
from twin.control.design import Table
from twin.control.existing import Existing, compare_tables
from twin.control.kinematics import (
    KinematicsAccount,
    KinematicsRequest,
    ReadKinematics,
    compare_kinematics,
    kinematics_outputs,
    kinematics_written,
    make_both,
    write_kinematics,
)
from twin.control.make import ControlTables, make
from twin.control.remains import CorrectedShare, RemainingErrors, VolumeError
from twin.control.request import Request

__all__ = [
    "Account",
    "ControlTables",
    "CorrectedShare",
    "Existing",
    "KinematicsAccount",
    "KinematicsRequest",
    "ReadKinematics",
    "RemainingErrors",
    "Request",
    "Table",
    "VolumeError",
    "account_of",
    "compare_kinematics",
    "compare_tables",
    "kinematics_outputs",
    "kinematics_written",
    "make",
    "make_both",
    "outputs_of",
    "write_folder",
    "write_kinematics",
    "written_by",
]
