"""Command line: one module per command; the only package that prints."""

from __future__ import annotations

import atexit
import gc
import os
import sys
from typing import Final

from twin.cli.shared import installation, terminal

__all__ = ["main"]

OBJECTS: Final = 20_000
"""New objects between two searches for unused reference cycles. A command makes many objects and few cycles: Python's own number, 700,
takes a twentieth of its time."""


def main(arguments: list[str] | None = None) -> None:
    """Run a command; if a required package cannot be imported, name it.

    The commands are imported in this function because they need those packages.
    """
    # Before NumPy is imported: starting its threads takes longer than importing it, and all large computations limit it to one.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Else pydantic searches all installed distributions for its plugins; twin uses none.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # A thread that returns from compiled code, where most of the work is done, waits this long (s) for one that runs Python.
    sys.setswitchinterval(2e-4)
    gc.set_threshold(OBJECTS, 10, 10)
    # The interpreter searches all objects for cycles when it ends: 0.2 s after a report, for nothing.
    atexit.register(gc.freeze)
    words = sys.argv[1:] if arguments is None else arguments
    if words[:1] == ["doctor"] and not {"-h", "--help"} & set(words) and not installation.can_start():
        installation.exit_with_findings()
    terminal.open_closed_streams()
    try:
        try:
            from twin.cli.commands import run
        except installation.IMPORT_FAILURES as error:
            installation.exit_with_import_error(error)
        try:
            run(words)
        except ImportError as error:
            installation.exit_with_import_error(error)
    except KeyboardInterrupt:
        # During the imports; from then on `run` ends the command.
        terminal.print_error("twin: interrupted, nothing half written")
        sys.exit(installation.INTERRUPTED)
