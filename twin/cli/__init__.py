"""Command line: one module per command; the only package that prints."""

from __future__ import annotations

import os
import sys

from twin.cli.shared import installation

__all__ = ["main"]


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
    words = sys.argv[1:] if arguments is None else arguments
    if words[:1] == ["doctor"] and not {"-h", "--help"} & set(words) and not installation.can_start():
        installation.exit_with_findings()
    try:
        from twin.cli.commands import run
    except installation.IMPORT_FAILURES as error:
        installation.exit_with_import_error(error)
    try:
        run(words)
    except ImportError as error:
        installation.exit_with_import_error(error)
