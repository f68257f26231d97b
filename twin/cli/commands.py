"""All commands, and one run of one of them: its exit status, and its errors in one line."""

from __future__ import annotations

import sys

# In this order in the help.
from twin.cli import info, compare, volume, compensate, path, scene, simulate  # isort: skip
from twin.cli import identify, axis_run, diagnose, plan, report, control, doctor, doc  # isort: skip
from twin.cli.app import BAD_INPUT, INTERRUPTED, NOT_ALL_MET, app
from twin.cli.complete import told_word_by_word
from twin.cli.signals import as_interrupt
from twin.cli.usage import UsageError, help_of, line_of_usage
from twin.errors import InputError, OutputError
from twin.options import gathered

__all__ = [
    "app",
    "axis_run",
    "compare",
    "compensate",
    "control",
    "diagnose",
    "doc",
    "doctor",
    "identify",
    "info",
    "path",
    "plan",
    "report",
    "run",
    "scene",
    "simulate",
    "volume",
]


def run(arguments: list[str]) -> None:
    """Run a command: exit 0 done, 2 bad input or usage, 3 done but something was not met, 128 + n ended by signal n."""
    with as_interrupt() as received:
        try:
            # Not standalone: the parser's own errors are printed in one line, as all others.
            told_word_by_word()
            words = gathered(arguments)
            status = app(args=words, prog_name="twin", standalone_mode=False)
            if status == INTERRUPTED:  # the parser's own way to pass on KeyboardInterrupt
                raise KeyboardInterrupt
            sys.exit(status if isinstance(status, int) else 0)
        except UsageError as error:
            shown = help_of(error)
            if shown is None:
                print(f"twin: {line_of_usage(error)}", file=sys.stderr)
            else:
                print(shown, end="")
            sys.exit(BAD_INPUT)
        except InputError as error:
            option = "" if error.setting is None else f" (--{error.setting.replace(' ', '-')})"
            print(f"twin: {error}{option}", file=sys.stderr)
            sys.exit(BAD_INPUT)
        except OutputError as error:
            print(f"twin: defect, nothing written: {error}", file=sys.stderr)
            sys.exit(NOT_ALL_MET)
        except KeyboardInterrupt:
            print(f"twin: {received.reason}, nothing half written", file=sys.stderr)
            sys.exit(received.status)
