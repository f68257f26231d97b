"""Compensation tables for a control, made from a calibration and checked by reading them back."""

from twin.control.account import Account
from twin.control.deliver import account_of, deliver, outputs_of, written_by
from twin.control.design import Table
from twin.control.existing import Existing, compared
from twin.control.make import Made, make
from twin.control.remains import Carried, LeftByTables, Remains
from twin.control.request import Request

__all__ = [
    "Account",
    "Carried",
    "Existing",
    "LeftByTables",
    "Made",
    "Remains",
    "Request",
    "Table",
    "account_of",
    "compared",
    "deliver",
    "make",
    "outputs_of",
    "written_by",
]
