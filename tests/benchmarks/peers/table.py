"""The page of the documentation with the measured ratios."""

from __future__ import annotations

import datetime
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from tests.benchmarks.peers.record import Row, Section, installed

PAGE: Final = Path(__file__).resolve().parents[3] / ".docs" / "pages" / "peers.md"
COMMAND: Final = "python -m tests.benchmarks peers --write"
HEADERS: Final = ("package", "version", "work", "points", "ratio (min to max)", "result")
INTRODUCTION: Final = """# Other packages

The tables compare processor times per point with those of `twin`, on the same data in the same run. The ratio is that of the best
times, followed by the smallest and the largest ratio over the repeats. Above 1, `twin` takes less time; below 1, it takes more. Lines
named `twin` show another way to call it. Processor time counts all threads.

In inverse kinematics, `twin` solves all poses in one call, in compiled code. The others solve one pose a call from Python, so for
single poses compare them with the line `twin`.

"""


def page(sections: Sequence[Section], computer: str, day: datetime.date) -> str:
    """Return the page as Markdown.

    Args:
        sections: measured tasks.
        computer: its name.
        day: date of the measurement.
    """
    made = f"Made by `{COMMAND}` on {day.isoformat()}: {computer}; Python {platform.python_version()}, NumPy {installed('numpy')}."
    return INTRODUCTION + made + "\n" + "".join(_section(one) for one in sections)


def _section(section: Section) -> str:
    lines = [_line(HEADERS), _line(["---"] * len(HEADERS)), *(_line(_cells(row)) for row in section.rows)]
    return f"\n## {section.title}\n\nRatio 1 is {section.ours}.\n\n" + "\n".join(lines) + "\n"


def _cells(row: Row) -> list[str]:
    if row.version is None:
        return [row.peer, "not installed", row.does, "", "", ""]
    return [row.peer, row.version, row.does, f"{row.points:,}", row.ratio_text, row.result or ""]


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
