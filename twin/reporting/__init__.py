"""Report of the state of a machine on one HTML page: largest errors, their effect at the tool, actions, uncertainty, sources.

Manual: `twin doc report`.
"""

from twin.reporting.result import SCHEMA, MachineReport, machine_report

__all__ = ["SCHEMA", "MachineReport", "machine_report"]
