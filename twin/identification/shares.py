"""The part of each instrument in an estimate from the readings of several."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from twin._common.counts import count_with_noun
from twin.identification.constant_errors import ConstantErrors, constant_errors
from twin.identification.network import Network
from twin.identification.setup import SetUp


@final
@dataclass(frozen=True)
class InstrumentShare:
    """One instrument's part in an estimate.

    Attributes:
        instrument: its name.
        stations: its stations.
        readings: number of coordinates or lengths that were used.
        rms_um: RMS of their residuals.
        reduced_chi2: mean square of their whitened residuals; about 1 if their stated uncertainty is right.
        alone: which constant errors its readings alone determine; None if it moved no axis that has any.
    """

    instrument: str
    stations: tuple[str, ...]
    readings: int
    rms_um: float
    reduced_chi2: float
    alone: ConstantErrors | None

    @property
    def text(self) -> str:
        """One line."""
        alone = "" if self.alone is None else f"; alone: {self.alone.text}"
        return (
            f"{self.instrument} ({', '.join(self.stations)}): {count_with_noun(self.readings, 'reading')}, residuals "
            f"{self.rms_um:.3g} µm RMS, reduced chi² {self.reduced_chi2:.3g}{alone}"
        )


def instrument_shares(
    network: Network, setup: SetUp, used: np.ndarray, residual_mm: np.ndarray, whitened: np.ndarray
) -> tuple[InstrumentShare, ...]:
    """Return the part of each instrument; empty if there is only one.

    Args:
        network: all readings and their instruments.
        setup: the estimated set-up.
        used: (n,) rows that were used.
        residual_mm: (n, 3) residuals, NaN where nothing was read.
        whitened: (n, 3) the same divided by the stated standard deviations.
    """
    data, found = network.data, []
    if len(network.instruments.every) == 1:
        return ()
    for instrument, rows in network.instruments.groups(data.station):
        own = rows[used[rows]]
        read = network.read[own]
        part = data.select(own)
        alone = None
        if len(own):
            part_setup, part_covariance = setup.of(part), network.covariance[own]
            alone = constant_errors(network.machine, part, network.instruments, part_setup, part_covariance)
        square = float(np.mean(whitened[own][read] ** 2)) if read.any() else float("nan")
        rms = float(np.sqrt(np.nanmean(residual_mm[own] ** 2))) * 1e3 if read.any() else float("nan")
        stations = tuple(dict.fromkeys(data.station[rows].tolist()))
        found.append(InstrumentShare(instrument.name, stations, int(read.sum()), rms, square, alone))
    return tuple(found)
