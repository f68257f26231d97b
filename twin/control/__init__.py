"""Compensation tables for a machine's control, computed from a calibration and checked by reading the files back."""

from twin.control.account import Account
from twin.control.deliver import account_of, deliver, outputs_of, written_by
from twin.control.design import Table
from twin.control.existing import Existing, compared
from twin.control.make import ControlTables, make
from twin.control.remains import Carried, Remains, VolumeError
from twin.control.request import Request

__all__ = [
    "Account",
    "Carried",
    "ControlTables",
    "Existing",
    "Remains",
    "Request",
    "Table",
    "VolumeError",
    "account_of",
    "compared",
    "deliver",
    "make",
    "outputs_of",
    "written_by",
]
