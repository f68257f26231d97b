"""Every benchmark, one after the other: ``python -m tests.benchmarks [NAME ...]`` (half an hour; a name alone is quicker)."""

from __future__ import annotations

import sys
from collections.abc import Callable

from tests.benchmarks import curves, diagnosis, figures, growth, programs, solve

EVERY: dict[str, Callable[[], object]] = {
    "solve": solve.main,
    "programs": lambda: programs.main([]),
    "diagnosis": lambda: diagnosis.main([]),
    "growth": lambda: growth.main([]),
    "figures": figures.main,
    "curves": curves.main,
}


def main(names: list[str]) -> int:
    """Those named, or all."""
    strange = [name for name in names if name not in EVERY]
    if strange:
        sys.stderr.write(f"no such benchmark: {strange[0]} (there are {', '.join(EVERY)})\n")
        return 2
    for name in names or EVERY:
        print(f"== {name}", flush=True)
        EVERY[name]()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
