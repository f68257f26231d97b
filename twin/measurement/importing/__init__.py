"""Measured tables as other programs write them: any CSV dialect and Excel workbooks as measurement tables.

Manual: `twin doc import`.
"""

from twin.measurement.importing.importer import ImportedTable, import_table
from twin.measurement.importing.mapping import SCHEMA, ColumnMapping

__all__ = ["SCHEMA", "ColumnMapping", "ImportedTable", "import_table"]
