"""Model selection: stepwise selection by BIC, on the readings and candidates of `tests.benchmarks.diagnosis`."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from tests.benchmarks import diagnosis
from tests.benchmarks.peers.record import Measured, Peer, Section, section
from tests.benchmarks.timing import timed
from twin.diagnosis import diagnose
from twin.machine.machine import Machine
from twin.measurement.table import Measurements

POINTS = 1_000
REPEATS = 3
Key = tuple[str, str]


@cache
def _data(machine: Machine) -> Measurements:
    return diagnosis.measured(machine, POINTS)


def result(named: tuple[Key, ...], hidden: tuple[Key, ...]) -> str:
    """Return how many of the hidden causes are among those named, and how many are named besides."""
    right = set(named) & set(hidden)
    return f"{len(right)} of {len(hidden)} hidden effects named, {len(set(named) - right)} others"


def _measured(machine: Machine, names: Callable[[Measurements], tuple[Key, ...]]) -> Measured:
    data, hidden = _data(machine), tuple(effect.key for effect in diagnosis.EFFECTS)
    n = len(data)
    return Measured(timed(lambda: names(data), REPEATS).each(n), n, result(names(data), hidden))


def sections(machine: Machine) -> tuple[Section, ...]:
    """Return the comparison."""

    def whole(data: Measurements) -> tuple[Key, ...]:
        return tuple((cause.effect, cause.where) for cause in diagnose(data, machine).causes)

    peers = [
        Peer(
            ("statsmodels", "scikit-learn"),
            "stepwise selection by the BIC of `OLS`, with candidates and regressors of `twin`",
            lambda: _measured(machine, lambda data: diagnosis.by_bic(data, machine)),
        ),
        Peer(
            ("twin",),
            "`diagnose`: sizes with intervals, confounded effects, gain on held-out rounds, next measurement, too",
            lambda: _measured(machine, whole),
        ),
    ]
    ours = _measured(machine, lambda data: diagnosis.by_twin(data, machine))
    title = "Model selection (points are measured points, three coordinates each)"
    return (section(title, "from readings to the names of the causes", ours, peers),)
