"""All commands, and one run of one of them: its exit status, and its errors in one line."""

from __future__ import annotations

import sys

# In this order in the help.
from twin.cli import info, compare, volume, compensate, path, scene, simulate  # isort: skip
from twin.cli import identify, axis_run, diagnose, plan, report, control, doctor, doc  # isort: skip
from twin._common.errors import InputError, OutputError
from twin.cli.shared.command import app
from twin.cli.shared.complete import told_word_by_word
from twin.cli.shared.installation import BAD_INPUT, INTERRUPTED, NOT_ALL_MET
from twin.cli.shared.signals import as_interrupt
from twin.cli.shared.terminal import (
    BROKEN_PIPE,
    accept_any_text,
    discard_output,
    echo,
    flush,
    line_of_failure,
    tell_error,
)
from twin.cli.shared.usage import UsageError, help_of, line_of_usage
from twin.cli.shared.words import gathered

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
    accept_any_text()
    with as_interrupt() as received:
        try:
            sys.exit(_run(arguments))
        except UsageError as error:
            shown = help_of(error)
            if shown is None:
                tell_error(f"twin: {line_of_usage(error)}")
            else:
                echo(shown, end="")
            sys.exit(BAD_INPUT)
        except InputError as error:
            option = "" if error.setting is None else f" (--{error.setting.replace(' ', '-')})"
            tell_error(f"twin: {error}{option}")
            sys.exit(BAD_INPUT)
        except OutputError as error:
            tell_error(f"twin: defect, nothing written: {error}")
            sys.exit(NOT_ALL_MET)
        except BrokenPipeError:
            discard_output()
            sys.exit(BROKEN_PIPE)
        except OSError as error:
            discard_output()
            tell_error(f"twin: {line_of_failure(error)}")
            sys.exit(BAD_INPUT)
        except KeyboardInterrupt:
            tell_error(f"twin: {received.reason}, nothing half written")
            sys.exit(received.status)


def _run(words: list[str]) -> int:
    """Run the command of these words and return its exit status, with everything printed."""
    for word in words:
        if "\0" in word:
            raise InputError("a NUL character in an argument", expected="text without it", value=word)
    # Not standalone: the parser's own errors are printed in one line, as all others.
    told_word_by_word()
    try:
        status = app(args=gathered(words), prog_name="twin", standalone_mode=False)
    except SystemExit as stop:
        # The parser's own way to deal with a closed pipe.
        if isinstance(stop.__context__, BrokenPipeError):
            raise stop.__context__ from None
        raise
    if status == INTERRUPTED:  # the parser's own way to pass on KeyboardInterrupt
        raise KeyboardInterrupt
    flush()
    return status if isinstance(status, int) else 0
