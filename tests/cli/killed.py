"""Run a command of `twin` repeatedly and kill it at each of its file operations in a folder, one operation later each time.

`python -m tests.cli.killed FOLDER FILE ARGUMENT…` prints, as JSON, the content of FILE after each kill and, last, after an undisturbed
run. Kills happen at operations, not at times, so that they do not depend on the speed of the computer.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path

from twin import cli
from twin.cli.commands import load

STEPS = ("open", "os.chmod", "os.rename", "os.remove")  # audit events, raised before the operation


def run(folder: Path, arguments: list[str], last: int) -> None:
    """Run the command until just before its `last` operation in the folder."""
    taken = 0

    def audit(event: str, arguments_of_event: tuple[object, ...]) -> None:
        nonlocal taken
        if (
            event in STEPS
            and isinstance(arguments_of_event[0], str | os.PathLike)
            and folder in Path(arguments_of_event[0]).parents
        ):
            taken += 1
            if taken == last:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(audit)
    cli.main(arguments)


def main(folder: str, file: str, *arguments: str) -> None:
    """Print the content of the file after each kill."""
    out = Path(file)
    old, found = out.read_text(), []
    load(arguments[0])  # once, before the forks
    while True:
        out.write_text(old)
        child = os.fork()
        if not child:
            sys.stdout = sys.stderr = open(os.devnull, "w")
            run(Path(folder), list(arguments), len(found) + 1)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        found.append(out.read_text())
        if not os.WIFSIGNALED(status):
            print(json.dumps(found))
            sys.exit(os.waitstatus_to_exitcode(status))


if __name__ == "__main__":
    main(*sys.argv[1:])
