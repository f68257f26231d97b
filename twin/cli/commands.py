"""The table of commands, and the run of one: its exit status and its one-line errors."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Annotated, Any, Final

import typer
from typer.core import TyperCommand, TyperGroup

from twin._common.errors import InputError, OutputError
from twin.cli.shared import installation
from twin.cli.shared.command import HELP, UsageError, as_interrupt, help_text, registered, usage_message
from twin.cli.shared.installation import BAD_INPUT, INTERRUPTED, NOT_ALL_MET
from twin.cli.shared.terminal import (
    BROKEN_PIPE,
    accept_any_text,
    discard_output,
    echo,
    expand_bash_line,
    flush,
    os_error_message,
    print_error,
    repeat_options,
)

__all__ = ["COMMANDS", "app", "load", "run"]

COMMANDS: Final = {
    "info": "Show axes, ranges, frames and the error budget of a machine.",
    "machine": "Describe your own machine by answers, and check it against its control.",
    "compare": "Show what changed between two calibrations of a machine.",
    "confirm": "Confirm that what was written into the machine took effect, or that a crash moved nothing.",
    "volume": "Show the spread of errors over machines drawn from a calibration's covariance.",
    "forecast": "Forecast which tolerances of a part a program holds on this machine.",
    "check": "Examine NC programs before anything is computed.",
    "compensate": "Rewrite NC programs so that the real machine cuts what was programmed.",
    "verify": "Let a control execute a program, and evaluate the error over the whole motion.",
    "path": "Fit the same tool path with fewer blocks.",
    "scene": "Show the machine running a program, in one HTML file.",
    "simulate": "Simulate the measurement of a plan on a machine with errors.",
    "import": "Import a table of measured points: any CSV or Excel workbook.",
    "convert": "Convert measured data of other programs into a measurement table.",
    "identify": "Identify error motions from measured points, with their uncertainty.",
    "axis-run": "Identify the six error motions of a linear axis from interferometer readings.",
    "simulate-run": "Simulate the interferometer readings of a linear axis.",
    "evaluate": "Evaluate standard tests (ISO 230, ISO 10791-6) from measured points.",
    "thermal": "Fit displacements to temperatures and spindle speed over time.",
    "diagnose": "Find what the model gets wrong about measured data, and name the cause.",
    "watch": "Watch a folder of checks: what changed, since when, is the calibration still good.",
    "plan": "Plan the next measurement.",
    "report": "Report the state of a machine, in one HTML file.",
    "control": "Write and read the compensation tables of a control.",
    "demo": "Run a small example of everything, and write one page that shows it.",
    "doctor": "Check the installation.",
    "doc": "Show a page of the manual.",
}
"""The commands in the order of the help, each with its summary. A command's module has its name; see `MODULES` for the others."""
MODULES: Final = {
    **dict.fromkeys(("axis-run", "simulate-run"), "axis_run"),
    **dict.fromkeys(("check", "compensate", "path", "verify"), "programs"),
    **dict.fromkeys(("compare", "watch"), "changes"),
    **dict.fromkeys(("convert", "import"), "foreign_files"),
}


class LazyGroup(TyperGroup):
    """Imports a command's module when that command runs: the list of commands needs none of them."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command as the list of commands shows it, with its name and summary only; None if there is none of that name."""
        return TyperCommand(cmd_name, help=COMMANDS[cmd_name]) if cmd_name in COMMANDS else None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the name, the command and the arguments left, as the parser asks for them before a command runs."""
        name, found, rest = super().resolve_command(ctx, args)
        return name, found if name is None else load(name), rest


app = typer.Typer(
    cls=LazyGroup,
    help="A digital twin of a five-axis machine tool that finds, from measurements, where its own model is wrong.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    context_settings=HELP,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        echo(f"twin {version('twin')}")
        raise typer.Exit


VersionOption = Annotated[
    bool, typer.Option("--version", help="Show the version.", callback=_print_version, is_eager=True)
]


@app.callback()
def _twin(version: VersionOption = False) -> None:
    """Make `app` a group although no command is registered with it."""


def load(name: str) -> Any:
    """Import the module of one of `COMMANDS` and return the command for the parser; where a package does not import, say which."""
    try:
        import_module(f"twin.cli.{MODULES.get(name, name)}")
    except installation.IMPORT_FAILURES as error:
        installation.exit_with_import_error(error)
    return typer.main.get_group(registered).commands[name]


def run(arguments: list[str]) -> None:
    """Run a command: exit 0 done, 2 bad input or usage, 3 done but something was not met, 128 + n ended by signal n."""
    accept_any_text()
    with as_interrupt() as received:
        try:
            sys.exit(_run(arguments))
        except UsageError as error:
            shown = help_text(error)
            if shown is None:
                print_error(f"twin: {usage_message(error)}")
            else:
                echo(shown, end="")
            sys.exit(BAD_INPUT)
        except InputError as error:
            options = [f"--{name.replace(' ', '-')}" for name in (error.setting or "").split(", ") if name]
            print_error("twin: " + error.text(f" ({', '.join(options)})" if options else ""))
            sys.exit(BAD_INPUT)
        except OutputError as error:
            print_error(f"twin: defect, nothing written: {error}")
            sys.exit(NOT_ALL_MET)
        except BrokenPipeError:
            discard_output()
            sys.exit(BROKEN_PIPE)
        except OSError as error:
            discard_output()
            print_error(f"twin: {os_error_message(error)}")
            sys.exit(BAD_INPUT)
        except MemoryError:
            print_error(
                "twin: out of memory, nothing half written; expected a smaller input, or a computer with more memory"
            )
            sys.exit(BAD_INPUT)
        except KeyboardInterrupt:
            print_error(f"twin: {received.reason}, nothing half written")
            sys.exit(received.status)


def _run(words: list[str]) -> int:
    """Run the command of these words and return its exit status, with everything printed."""
    for word in words:
        if "\0" in word:
            raise InputError("a NUL character in an argument", expected="text without it", value=word)
    # Not standalone: the parser's own errors are printed in one line, as all others.
    expand_bash_line()
    try:
        status = app(args=repeat_options(words), prog_name="twin", standalone_mode=False)
    except SystemExit as stop:
        # The parser's own way to deal with a closed pipe.
        if isinstance(stop.__context__, BrokenPipeError):
            raise stop.__context__ from None
        raise
    if status == INTERRUPTED:  # the parser's own way to pass on KeyboardInterrupt
        raise KeyboardInterrupt
    flush()
    return status if isinstance(status, int) else 0
