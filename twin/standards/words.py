"""Words of the tests: places of runs."""

from __future__ import annotations

from twin.standards.runs import MeasuredRun


def place_of(run: MeasuredRun) -> str:
    """Return the positions of the axes that stand still, with target and station: ``at Y 225, Z −200; target K, station 1``."""
    rest = ", ".join(f"{name} {value:g}".replace("-", "−") for name, value in run.where.items())
    return f"{f'at {rest}; ' if rest else ''}target {run.target}, station {run.station}"
