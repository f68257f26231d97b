"""Compensation tables and kinematics of a machine's control: their formats, and the corrections that the control makes with them."""

from twin.machine.control.correction import Correction, TableSummary
from twin.machine.control.curve import ControlCurve, ControlTerm, TableSum
from twin.machine.control.format import TableFormat
from twin.machine.control.formats import format_named, read_tables, table_formats
from twin.machine.control.kinematics import kinematics_formats, kinematics_named
from twin.machine.control.section import ControlSection, TableEntry

__all__ = [
    "ControlCurve",
    "ControlSection",
    "ControlTerm",
    "Correction",
    "TableEntry",
    "TableFormat",
    "TableSum",
    "TableSummary",
    "format_named",
    "kinematics_formats",
    "kinematics_named",
    "read_tables",
    "table_formats",
]
