"""Random calibrations for tests: every curve, squareness and location of a machine, up to a given size."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.motion_curve import Curve


def random_calibration(machine: Machine, rng: np.random.Generator, size: float = 1000.0) -> Calibration:
    """Return a calibration with curves of at most ``size`` µm or µrad, and squareness and locations of a tenth of it."""
    curves = {}
    for name in machine.motion_names:
        axis = machine.by_name[name[3:]]
        if axis.lower is None or axis.upper is None:
            coefficients, domain, basis = rng.normal(size=7), (0.0, 360.0), "fourier"
        else:
            coefficients, domain, basis = rng.normal(size=6), (axis.lower, axis.upper), "power"
        coefficients *= size * rng.uniform(0.3, 1.0) / np.abs(coefficients).sum()
        unit = "um" if name[2] in "XYZ" else "urad"
        curves[name] = Curve(name, unit, domain, basis, tuple(float(c) for c in coefficients))
    squareness = {name: float(rng.uniform(-0.1, 0.1) * size) for name in machine.squareness_names}
    location = {name: float(rng.uniform(-0.1, 0.1) * size) for name in machine.location_names}
    return Calibration(machine, "drawn for a test", *(MappingProxyType(d) for d in (curves, squareness, location)))
