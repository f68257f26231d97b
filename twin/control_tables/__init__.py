"""Compensation tables for a control, made from a calibration and checked by reading them back."""

from twin.control_tables.account import Account
from twin.control_tables.deliver import account_of, deliver, outputs_of, written_by
from twin.control_tables.existing import Existing, compared
from twin.control_tables.make import Made, Request, Table, make
from twin.control_tables.remains import Carried, Left, Remains

__all__ = [
    "Account",
    "Carried",
    "Existing",
    "Left",
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
