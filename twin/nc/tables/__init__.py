"""Tables of work offsets and tools, as controls write them and as CSV."""

from twin.nc.tables.load import load_offsets, load_tools
from twin.nc.tables.table import OffsetTable, ToolTable

__all__ = ["OffsetTable", "ToolTable", "load_offsets", "load_tools"]
