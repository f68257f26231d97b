"""The noise with which an estimate weights its readings: as stated, or from repeats where these contradict it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from twin._common.arrays import read_only
from twin.identification.inputs import PreparedData
from twin.identification.network import stated_covariance
from twin.identification.spread import Repeats, Spread, covariance_from_repeats, noise_text, repeats_of
from twin.machine.machine import Machine
from twin.measurement.checks import ASSUMED
from twin.measurement.instruments import Instrument, others_alike


@final
@dataclass(frozen=True, eq=False)
class NoiseOfReadings:
    """Noise of the readings.

    Attributes:
        covariance: (n, 3, 3) m².
        spread: noise on which the covariance of the estimate is based; ``repeats`` where they contradict the stated noise.
        contradicted: names of the instruments whose stated noise the repeats contradict.
        assumed: names of the instruments that nothing but the kind of the readings indicates, and no repeats test.
        notices: what to know of it.
    """

    covariance: np.ndarray
    spread: Spread
    contradicted: tuple[str, ...]
    assumed: tuple[str, ...]
    notices: tuple[str, ...]

    def interval_text(self, *, incomplete: bool) -> str:
        """Return on which noise the intervals are based; ``incomplete``: whether residuals exceed the noise."""
        text = {
            "stated": "the stated uncertainty of the readings",
            "repeats": "the standard deviation of repeats",
            "between poses": "the variation between poses",
            "between rounds": "the variation between rounds",
        }[self.spread]
        return f"{text} and the model discrepancy" if incomplete and not self.spread.startswith("between") else text


def reading_noise(machine: Machine, placed: PreparedData, spread: Spread, *, named: bool) -> NoiseOfReadings:
    """Return the noise of the readings.

    If the repeats of an instrument vary more than its stated noise allows, their standard deviation is taken. If it has too few repeats
    to test its noise, and nothing names it, the assumption is stated.

    Args:
        machine: the machine.
        placed: rows and instruments.
        spread: source that was asked for; with ``repeats`` they are taken in any case.
        named: whether the user named the instrument of the stations for which the table does not.

    Raises:
        InputError: too few repeats for ``repeats``.
    """
    data, instruments = placed.data, placed.instruments
    stated = stated_covariance(data, instruments)
    repeats = repeats_of(machine, data, instruments, stated)
    if spread == "repeats":
        return NoiseOfReadings(covariance_from_repeats(data, instruments, repeats), spread, (), (), ())
    covariance = np.array(stated)
    by_instrument = {id(one.instrument): one for one in repeats}
    contradicted, assumed, notices = [], [], []
    for instrument, rows in instruments.groups(data.station):
        own, point = by_instrument.get(id(instrument)), data.point_mm[rows] * 1e-3
        of_table = bool(np.isfinite(data.u_mm[rows]).any())
        if own is not None and own.contradict:
            covariance[rows] = own.covariance
            contradicted.append(instrument.name)
            notices.append(_contradiction(own, of_table=of_table, point=point, stated=stated[rows]))
        elif not (of_table or named or all(data.instrument[rows]) or (own is not None and own.decide)):
            assumed.append(instrument.name)
            notices.append(
                f"{ASSUMED}the readings are those of a {instrument.specification.title}, "
                f"{noise_text(instrument, point, stated[rows])}: the table names no instrument and has too few repeats "
                f"to test this{_others(instrument)}"
            )
    return NoiseOfReadings(
        read_only(covariance),
        "repeats" if contradicted and spread == "stated" else spread,
        tuple(contradicted),
        tuple(assumed),
        tuple(notices),
    )


def _contradiction(repeats: Repeats, *, of_table: bool, point: np.ndarray, stated: np.ndarray) -> str:
    """Return the notice that repeats contradict the stated noise."""
    instrument = repeats.instrument
    source = "the table's uncertainties" if of_table else f"the noise of a {instrument.specification.title}"
    return (
        f"the repeats contradict {source} ({noise_text(instrument, point, stated)}): reduced chi² {repeats.reduced_chi2:.3g} "
        f"({repeats.dof} degrees of freedom a coordinate). Their standard deviation is taken instead: "
        f"{noise_text(instrument, point, repeats.covariance)}{'' if of_table else _others(instrument)}"
    )


def _others(instrument: Instrument) -> str:
    """Return the names of the other instruments with such readings, as a clause; empty if there is none."""
    names = others_alike(instrument)
    return f". If it was another one, name it: {', '.join(names)}" if names else ""
