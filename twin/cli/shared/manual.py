"""Pages of the manual in a terminal: nothing is cut or broken within a figure, however narrow the terminal is."""

from __future__ import annotations

import re
import textwrap
from typing import ClassVar, Final, final

from rich.console import Console, ConsoleOptions, RenderResult
from rich.markdown import CodeBlock, Markdown, MarkdownElement, TableElement
from rich.measure import Measurement
from rich.padding import Padding
from rich.text import Text

_INDENT: Final = 4
_OPTION: Final = re.compile(r" (?=-{1,2}[a-zA-Z])")


class _Code(CodeBlock):
    """A code block in its own lines; lines that are too long are continued (`code_lines`)."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = options.max_width - _INDENT
        lines = (part for line in str(self.text).rstrip().splitlines() for part in code_lines(line, width))
        for line in lines:
            yield Text(" " * _INDENT + line, style="cyan")


class _Table(TableElement):
    """A table; one that is wider than the terminal is printed row by row, each cell on its own line behind its heading."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        (table,) = super().__rich_console__(console, options)
        wide = options.update(max_width=10_000)
        if Measurement.get(console, wide, table).maximum <= options.max_width or self.body is None:  # type: ignore[arg-type]
            yield table
            return
        header = self.header.row.cells if self.header is not None and self.header.row is not None else []
        for row in self.body.rows:
            yield Text()
            for column, (heading, cell) in enumerate(zip(header, row.cells, strict=False)):
                name = f"{heading.content.plain}: " if heading.content.plain else ""
                if cell.content.plain:
                    line = Text.assemble((name, "dim"), (cell.content.plain, "bold" if column == 0 else ""))
                    yield Padding(line, (0, 0, 0, _INDENT if column else 0))


@final
class ManualPage(Markdown):
    """A page of the manual, to be printed by a rich console."""

    elements: ClassVar[dict[str, type[MarkdownElement]]] = {
        **Markdown.elements,
        "fence": _Code,
        "code_block": _Code,
        "table_open": _Table,
    }


def code_lines(line: str, width: int) -> list[str]:
    """Return a line of code in lines of at most ``width`` columns, without losing a word.

    A `twin` command is continued before an option, as a shell accepts it; other lines are continued at a space, indented further.
    """
    indent = " " * (len(line) - len(line.lstrip()) + _INDENT)
    if line.lstrip().startswith("twin "):
        words = _OPTION.split(line)
        found = [words[0]]
        for word in words[1:]:
            if len(found[-1]) + len(word) + len(" ") <= width - len(" \\"):
                found[-1] += f" {word}"
            else:
                found[-1] += " \\"
                found.append(f"{indent}{word}")
        return found
    return textwrap.wrap(line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False) or [""]
