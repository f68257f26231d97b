"""Test cases for each format of measured data, one module each.

Every module has a valid file (`FILE`, `GOOD`), written by hand or made from exact geometry after the public description of the format;
what the file does not say (`GIVEN`); the machine; the rows that it must give, computed without `twin` (`ROWS`, with `AGREES_MM`); and
changes that make it invalid (`BAD`: text, replacement, line and text of the error).
"""

from importlib import import_module

from twin.measurement.formats import FORMATS

CASES = {form.name: import_module(f"{__name__}.{form.name.replace('-', '_')}") for form in FORMATS}
