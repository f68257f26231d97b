#!/usr/bin/python3
"""Print what LinuxCNC's interpreter makes of a program, as JSON: its canonical calls in order, with line and unrounded numbers.

It runs in the system's own Python, which has LinuxCNC's module ``gcode``. Lengths are in inches, as that module gives them.
Arguments: the program, a parameter file, a tool table.
"""

import ctypes
import json
import re
import sys

import gcode

PATH, PARAMETERS, TOOLS = sys.argv[1:4]
EMPTY = (-1, *[0.0] * 12, 0)
ROWS = [dict(re.findall(r"([A-Z])([-+.0-9]+)", line)) for line in open(TOOLS)]


def load_tools():
    """Load the tool table into the memory where the interpreter looks for it, as ``rs274`` does."""
    library = ctypes.CDLL("libtooldata.so.0")
    library._Z17tool_mmap_creatorPK13EMC_TOOL_STATi(None, 0)
    library._Z13tooldata_initb(False)
    if library._Z13tooldata_loadPKcPPc(TOOLS.encode(), None):
        sys.exit("the tool table is not read")


class Canon:
    """Receiver of the canonical calls."""

    parameter_file = PARAMETERS

    def __init__(self):
        self.calls, self.line, self.spindle = [], 0, 0

    def next_line(self, state):
        self.line = state.sequence_number

    def change_tool(self, place):
        self.spindle = place

    def get_tool(self, place):
        place = place or self.spindle
        if not 0 < place <= len(ROWS):
            return EMPTY
        row = ROWS[place - 1]
        return (
            int(row["T"]),
            *(float(row.get(axis, 0.0)) for axis in "XYZABCUVW"),
            float(row.get("D", 0.0)),
            0.0,
            0.0,
            0,
        )

    def get_external_angular_units(self):
        return 1.0

    def get_external_length_units(self):
        return 1.0

    def get_axis_mask(self):
        return 0b111111

    def get_block_delete(self):
        return 0

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return lambda *arguments: self.calls.append((self.line, name, arguments))


load_tools()
canon = Canon()
result, line = gcode.parse(PATH, canon, "", "")
error = gcode.strerror(result) if result > gcode.MIN_ERROR else ""
print("\n" + json.dumps({"calls": canon.calls, "line": line, "error": error}, default=str))
