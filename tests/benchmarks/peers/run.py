"""Compare with other packages in the same run: ``python -m tests.benchmarks peers [--write]`` (five minutes).

Processor times per point of reading a program, inverse kinematics, calibration and model selection, as ratios to those of `twin`, with
the version of each package and its result: a fast wrong answer is no answer. The option ``--write`` writes the page
``.docs/pages/peers.md``. A package that is not installed is reported as such; ``pip install '.[peers,test]'`` installs all of them.
"""

from __future__ import annotations

import datetime

from tests.benchmarks.peers import calibration, inverse, parsing, selection
from tests.benchmarks.peers.record import Section
from tests.benchmarks.peers.table import PAGE, page
from tests.benchmarks.timing import machine_name
from twin.machine.machine import Machine


def sections(machine: Machine) -> list[Section]:
    """Measure all tasks."""
    return [one for task in (parsing, inverse, calibration, selection) for one in task.sections(machine)]


def main(*, write: bool = False) -> None:
    """Print all comparisons; ``write``: write the page of the documentation, too."""
    computer = machine_name()
    print(computer)
    found = sections(Machine.load("dmu50"))
    if write:
        PAGE.write_text(page(found, computer, datetime.date.today()), encoding="utf-8")
        print(f"written: {PAGE}")
