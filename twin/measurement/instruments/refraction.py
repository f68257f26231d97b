"""Refractive index of air, and its influence on a measured length.

Birch and Downs (1994), "Correction to the updated Edlén equation for the refractive index of air", Metrologia 31, 315-316, with the
saturation pressure of water vapour by the Magnus formula (WMO-No. 8, annex 4.B).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.errors import InputError

HELIUM_NEON_UM: Final = 0.6329908
"""Vacuum wavelength of a helium-neon laser, µm."""


@final
@dataclass(frozen=True)
class Air:
    """State of the air along the beam.

    Attributes:
        temperature_degC, pressure_hPa: temperature and pressure.
        humidity: relative, 0 to 1.

    Raises:
        InputError: a value that does not occur in a workshop.
    """

    temperature_degC: float = 20.0
    pressure_hPa: float = 1013.25
    humidity: float = 0.5

    def __post_init__(self) -> None:
        for what, value, low, high, unit in (
            ("air temperature", self.temperature_degC, -20.0, 60.0, " °C"),
            ("air pressure", self.pressure_hPa, 500.0, 1200.0, " hPa"),
            ("relative humidity", self.humidity, 0.0, 1.0, ""),
        ):
            if not low <= value <= high:
                raise InputError(f"{what} out of range", expected=f"{low:g} to {high:g}{unit}", value=value)


STANDARD_AIR: Final = Air()
"""20 °C, 1013.25 hPa, 50 %: the air assumed by an instrument without its own sensors."""


def refractive_index(air: Air, wavelength_um: float = HELIUM_NEON_UM) -> float:
    """Return the phase refractive index of air.

    Args:
        air: temperature, pressure, humidity.
        wavelength_um: vacuum wavelength, µm (visible).
    """
    t, p = air.temperature_degC, air.pressure_hPa * 100.0
    s = 1.0 / wavelength_um**2
    standard = 1e-8 * (8342.54 + 2406147.0 / (130.0 - s) + 15998.0 / (38.9 - s))
    density = (1.0 + 1e-8 * (0.601 - 0.00972 * t) * p) / (1.0 + 0.003661 * t)
    vapour = air.humidity * 611.2 * float(np.exp(17.62 * t / (243.12 + t)))
    dry = 1.0 + p * standard * density / 96095.43
    return dry - 1e-10 * vapour * (292.75 / (t + 273.15)) * (3.7345 - 0.0401 * s)


def length_scale(actual: Air, assumed: Air, wavelength_um: float = HELIUM_NEON_UM) -> float:
    """Return the factor on every length read if the instrument corrects for ``assumed`` air and the beam passes ``actual`` air."""
    return refractive_index(actual, wavelength_um) / refractive_index(assumed, wavelength_um)
