"""Compensation tables of the machine's control: made from a calibration, read back, and taken into account for programs.

Manual: `twin doc control`.
"""

from twin.compensation.tables.account import (
    Account,
    Existing,
    account_of,
    compare_tables,
    outputs_of,
    write_folder,
    written_by,
)
from twin.compensation.tables.design import Request, Table
from twin.compensation.tables.kinematics import (
    KinematicsAccount,
    KinematicsRequest,
    ReadKinematics,
    compare_kinematics,
    kinematics_outputs,
    kinematics_written,
    make_both,
    write_kinematics,
)
from twin.compensation.tables.make import ControlTables, make
from twin.compensation.tables.remains import CorrectedShare, RemainingErrors, VolumeError

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
