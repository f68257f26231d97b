"""Run a command of `twin`, killed without warning at each of its steps on the files of a folder, one step further each time.

`python -m tests.cli.killed FOLDER FILE ARGUMENT…` prints, as JSON, what FILE holds after each kill and, last, after the run that none
cut short. Steps, not moments: where a kill falls does not depend on how fast the machine is.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path

from twin import cli
from twin.cli.commands import load

STEPS = ("open", "os.chmod", "os.rename", "os.remove")  # of `sys.addaudithook`; told before the step is taken


def run(folder: Path, arguments: list[str], last: int) -> None:
    """Run the command until it is about to take its `last` step in the folder."""
    taken = 0

    def about_to(event: str, told: tuple[object, ...]) -> None:
        nonlocal taken
        if event in STEPS and isinstance(told[0], str | os.PathLike) and folder in Path(told[0]).parents:
            taken += 1
            if taken == last:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(about_to)
    cli.main(arguments)


def main(folder: str, file: str, *arguments: str) -> None:
    """What the file holds after each kill."""
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
