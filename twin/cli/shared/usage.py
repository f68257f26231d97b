"""Usage errors in one line: the offending text, the nearest valid name, and the help to consult."""

from __future__ import annotations

import re
from typing import Any

import typer

from twin._common.errors import did_you_mean

# Not every version of typer exports the parser's exception classes; this is their common base.
UsageError: type[Exception] = typer.BadParameter.__mro__[1]


def usage_message(error: Any) -> str:
    """Return the message of a usage error, in one line.

    Args:
        error: an instance of `UsageError`.
    """
    context = getattr(error, "ctx", None)
    path = "twin" if context is None else str(context.command_path)
    example = _example(context) if type(error).__name__ == "MissingParameter" else None
    if example is not None:
        return f"{_message(error, context)}; expected, for example, `{example}` (all options: {path} --help)"
    return f"{_message(error, context)}; expected what `{path} --help` lists"


def help_text(error: Any) -> str | None:
    """Return the help text if the command line was empty; None otherwise."""
    if type(error).__name__ != "NoArgsIsHelpError":
        return None
    return str(error.ctx.get_help())


def _example(context: Any) -> str | None:
    """Return the first example of a command's help; None if it has none."""
    examples = [
        line for line in (getattr(context.command, "epilog", None) or "").splitlines() if line.startswith("twin ")
    ]
    return examples[0] if examples else None


def _message(error: Any, context: Any) -> str:
    text = " ".join(str(error.format_message()).split()).rstrip(".")
    option = getattr(error, "option_name", None)
    if option is not None and context is not None and type(error).__name__ == "NoSuchOption":
        known = [name for one in context.command.params for name in (*one.opts, *one.secondary_opts)]
        return f"no such option: {option!r}{did_you_mean(option, [name for name in known if name.startswith('-')])}"
    command = re.search(r"No such command '([^']*)'", text)
    if command is not None and context is not None:
        known = context.command.list_commands(context)
        return f"no such command: {command[1]!r}{did_you_mean(command[1], known)}"
    choice = re.search(r"'([^']*)' is not one of (.*)$", text)
    if choice is not None:
        known = re.findall(r"'([^']*)'", choice[2])
        text = text.replace("Value error, ", "") + did_you_mean(choice[1], known)
    return text[0].lower() + text[1:] if text else "cannot be used"
