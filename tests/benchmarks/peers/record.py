"""Peers and their measurement: what each does, its version, its time per point, and what it reaches."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

from tests.benchmarks.timing import Timing, number, ratio_range


@dataclass(frozen=True)
class Measured:
    """A measurement: time per point in µs, number of points, and the result in words, with its unit."""

    each: Timing
    points: int
    result: str


@dataclass(frozen=True)
class Peer:
    """A peer.

    Attributes:
        package: name on PyPI; of several packages, the one that does the work first.
        does: its work, and how it differs from that of `twin`.
        measure: imports and measures it; called only if all packages are installed.
    """

    package: tuple[str, ...]
    does: str
    measure: Callable[[], Measured]


@dataclass(frozen=True)
class Row:
    """A line of the table; ``ratio``: of the best times, its smallest and its largest value.

    Version, points, ratio and result are None for a peer that is not installed; ``peer`` then names the missing packages.
    """

    peer: str
    does: str
    version: str | None = None
    points: int | None = None
    ratio: tuple[float, float, float] | None = None
    result: str | None = None

    def text(self) -> str:
        """Return the line for the terminal."""
        if self.version is None:
            return f"  {self.peer}: not installed"
        return f"  {self.peer} {self.version}: {self.ratio_text} times ours, {self.points:,} points. {self.does}. {self.result}"

    @property
    def ratio_text(self) -> str:
        """The ratio as text: best (smallest to largest)."""
        if self.ratio is None:
            return ""
        best, low, high = map(number, self.ratio)
        return f"{best} ({low} to {high})"


@dataclass(frozen=True)
class Section:
    """A task: its title, the work of `twin` that has ratio 1, and the rows."""

    title: str
    ours: str
    rows: tuple[Row, ...]


def installed(package: str) -> str | None:
    """Return the version of an installed package, or None."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def row(peer: Peer, ours: Timing) -> Row:
    """Measure a peer, if installed.

    Args:
        peer: the peer.
        ours: time per point of `twin`, µs.
    """
    missing = [package for package in peer.package if installed(package) is None]
    if missing:
        return Row(", ".join(missing), peer.does)
    found = peer.measure()
    return Row(
        peer.package[0],
        peer.does,
        installed(peer.package[0]),
        found.points,
        ratio_range(found.each, ours),
        found.result,
    )


def section(title: str, work: str, ours: Measured, peers: Iterable[Peer]) -> Section:
    """Measure all peers of a task and print each line as it is measured."""
    line = f"{work}: {number(ours.each.best)} µs per point ({ours.points:,} points); {ours.result}"
    print(f"{title}\n  twin: {line}", flush=True)
    rows: Sequence[Row] = []
    for peer in peers:
        found = row(peer, ours.each)
        print(found.text(), flush=True)
        rows = [*rows, found]
    return Section(title, line, tuple(rows))
