"""The command line: arguments in, files and one account of them out; one file a command. The only room that prints."""

from __future__ import annotations

import sys

from twin.cli import info, volume, compensate, path, scene, simulate, identify, axis_run, diagnose, plan  # isort: skip  # in this order in the help
from twin.cli.app import BAD_INPUT, INTERRUPTED, NOT_ALL_MET, app
from twin.errors import InputError, OutputError
from twin.options import gathered

__all__ = [
    "app",
    "axis_run",
    "compensate",
    "diagnose",
    "identify",
    "info",
    "main",
    "path",
    "plan",
    "scene",
    "simulate",
    "volume",
]


def main(arguments: list[str] | None = None) -> None:
    """Entry point: exit 0 done, 2 bad input or usage, 3 done but something could not be met, all of it listed."""
    try:
        app(args=gathered(sys.argv[1:] if arguments is None else arguments), standalone_mode=True)
    except InputError as error:
        print(f"twin: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    except OutputError as error:
        print(f"twin: defect, nothing written: {error}", file=sys.stderr)
        sys.exit(NOT_ALL_MET)
    except KeyboardInterrupt:
        print("twin: interrupted, nothing written", file=sys.stderr)
        sys.exit(INTERRUPTED)
