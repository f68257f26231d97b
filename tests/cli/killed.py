"""Run a command of `twin` and note what a kill at each of its file operations in a folder would leave in a file.

`python -m tests.cli.killed FOLDER FILE ARGUMENT…` prints, as JSON, the content of FILE just before each operation and, last, after the
run: a process killed at that moment can no longer change it. The moments are operations, not times, so that they do not depend on the
speed of the computer.
"""

from __future__ import annotations

import io
import json
import os
import sys
from pathlib import Path

from twin import cli

STEPS = ("open", "os.chmod", "os.rename", "os.remove")  # audit events, raised before the operation


def main(folder: str, file: str, *arguments: str) -> None:
    """Print the content of the file before each operation and after the run."""
    out, found = Path(file), []
    reading = False

    def audit(event: str, arguments_of_event: tuple[object, ...]) -> None:
        nonlocal reading
        if (
            event in STEPS
            and not reading
            and isinstance(arguments_of_event[0], str | os.PathLike)
            and Path(folder) in Path(arguments_of_event[0]).parents
        ):
            reading = True
            found.append(out.read_text())
            reading = False

    sys.addaudithook(audit)
    printed, sys.stdout = sys.stdout, io.StringIO()
    try:
        cli.main(list(arguments))
    except SystemExit as end:
        assert not end.code
    reading = True
    printed.write(json.dumps([*found, out.read_text()]))


if __name__ == "__main__":
    main(*sys.argv[1:])
