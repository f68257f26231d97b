"""Run all benchmarks, or those named: ``python -m tests.benchmarks [NAME ...]`` (half an hour for all).

``python -m tests.benchmarks peers --write`` also writes the measured ratios into the documentation.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

from tests.benchmarks import control_cycle, curves, diagnosis, figures, folder, growth, part, programs, sequences, solve
from tests.benchmarks.peers import run as peers

EVERY: dict[str, Callable[[], object]] = {
    "solve": solve.main,
    "programs": lambda: programs.main([]),
    "folder": lambda: folder.main([]),
    "diagnosis": lambda: diagnosis.main([]),
    "growth": lambda: growth.main([]),
    "figures": figures.main,
    "curves": curves.main,
    "sequences": sequences.main,
    "part": lambda: part.main([]),
    "control_cycle": control_cycle.main,
    "peers": peers.main,
}


def main(arguments: list[str]) -> int:
    """Run the named benchmarks, or all."""
    if arguments == ["peers", "--write"]:
        peers.main(write=True)
        return 0
    names = arguments
    unknown = [name for name in names if name not in EVERY]
    if unknown:
        sys.stderr.write(f"no such benchmark: {unknown[0]}; expected one of {', '.join(EVERY)}\n")
        return 2
    for name in names or EVERY:
        print(f"== {name}", flush=True)
        EVERY[name]()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
