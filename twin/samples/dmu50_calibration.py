"""Generate ``urdf/dmu50.calibration.yaml``: run ``python -m twin.samples.dmu50_calibration > urdf/dmu50.calibration.yaml``.

Three curves are published numbers: the translational error motions of X, recovered from the compensated NC data that figure
3.11 of Ellingsdalen (2021) prints. All other errors of that machine were published only as pictures and words. The remaining 27
curves and the squareness errors are illustrative: drawn by a seeded random generator with the magnitudes stated in words.

The file is in the datum `mean lines` (`twin.model.datum`). It describes the same machine at the tool, with the constants and lines
of the drawn curves moved to squareness and locations.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.polynomial import chebyshev

from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.datum import MEAN_LINES
from twin.model.motion_curve import Curve

FIGURE_3_11: Final = np.array(
    [
        [50, 49.9956, -0.000949353, -0.00156385],
        [100, 99.9937, -0.000753776, 0.000895042],
        [150, 149.993, -0.000362045, -0.00238055],
        [200, 199.992, -0.000215857, -0.00110904],
        [250, 249.99, -0.000387325, 0.00149589],
        [300, 299.987, -0.000716486, 0.000389921],
        [350, 349.984, -0.000948794, -0.000920075],
        [400, 399.981, -0.000872622, 0.00182009],
        [450, 449.979, -0.000456766, 0.000298728],
        [500, 499.981, 1.20629e-05, -0.00292907],
    ]
)
"""Nominal X, compensated X, Y, Z in mm as printed: compensated = nominal − deviation."""

PUBLISHED: Final = {
    "E_XX": (1, 4, "thesis figure 3.11: degree 4 without constant, within 0.5 µm of the printed X"),
    "E_YX": (
        2,
        5,
        "thesis figure 3.11: degree 5 without constant, exact to the printed digits; reference line removed",
    ),
    "E_ZX": (
        3,
        8,
        "thesis figure 3.11: degree 8 without constant, exact to the printed digits; reference line removed",
    ),
}
"""Error motion: (column of figure 3.11, polynomial degree, source)."""

SEED: Final = 2021
SHAPES: Final[Mapping[str, tuple[float, str]]] = {
    "E_AX": (-250.0, "peak: thesis, about -250 µrad at 300 mm"),
    "E_BX": (150.0, "magnitude: thesis, within 200 µrad"),
    "E_CX": (-120.0, "magnitude: thesis, within 200 µrad"),
    "E_XY": (5.2, "magnitude: thesis, just over 5 µm"),
    "E_YY": (40.8, "peak: thesis, 40.8 µm"),
    "E_ZY": (4.0, "magnitude: thesis, much below E_YY"),
    "E_AY": (160.0, "magnitude: thesis, like the X axis's"),
    "E_BY": (-140.0, "magnitude: thesis, like the X axis's"),
    "E_CY": (110.0, "magnitude: thesis, like the X axis's"),
    "E_XZ": (-8.0, "magnitude: thesis, about half of E_ZZ"),
    "E_YZ": (8.0, "magnitude: thesis, about half of E_ZZ"),
    "E_ZZ": (-16.5, "peak: thesis, -16.5 µm"),
    "E_AZ": (700.0, "peak: thesis, just over 700 µrad"),
    "E_BZ": (-300.0, "magnitude: thesis, larger than those of X and Y"),
    "E_CZ": (200.0, "magnitude: thesis, larger than those of X and Y"),
    "E_XB": (6.0, "magnitude: ours"),
    "E_YB": (-5.0, "magnitude: ours"),
    "E_ZB": (7.0, "magnitude: ours"),
    "E_AB": (9.0, "magnitude: thesis, negligible beside those of C"),
    "E_BB": (-8.0, "magnitude: thesis, negligible beside those of C"),
    "E_CB": (10.0, "magnitude: thesis, negligible beside those of C"),
    "E_XC": (5.0, "magnitude: thesis, below E_ZC"),
    "E_YC": (-6.0, "magnitude: thesis, below E_ZC"),
    "E_ZC": (15.0, "magnitude: thesis, the largest of C, cyclic"),
    "E_AC": (60.0, "magnitude: ours, well above those of B"),
    "E_BC": (-55.0, "magnitude: ours, well above those of B"),
    "E_CC": (50.0, "magnitude: ours, well above those of B"),
}
"""Drawn error motion: (signed peak in µm or µrad, origin of that value)."""

SQUARENESS: Final = {"E_C0Y": 22.0, "E_A0Z": -31.0, "E_B0Z": 18.0}
"""Illustrative values, µrad."""

SOURCE: Final = (
    "E_XX, E_YX, E_ZX: recovered from figure 3.11 of Ellingsdalen (2021). ILLUSTRATIVE: the other 27 error motions and the "
    "squareness errors, drawn to magnitudes the thesis states in words. Not a measurement of any machine: do not cut with it."
)


def calibration(machine: Machine) -> Calibration:
    """Return the default calibration of the DMU 50: `as_drawn`, in mean lines, coefficients rounded to 1e-6 µm or µrad."""
    drawn = as_drawn(machine)
    mean_lines = drawn.in_datum(MEAN_LINES)
    curves = {}
    for name, curve in mean_lines.curves.items():
        moved = " Datum changed to mean lines: constant and line moved to other errors." if name in PUBLISHED else ""
        coefficients = tuple(round(c, 6) + 0.0 for c in curve.coefficients)
        curves[name] = replace(
            curve, coefficients=coefficients, source=f"{curve.source}.{moved}" if moved else curve.source
        )
    squareness, location = (
        MappingProxyType({name: round(value, 6) for name, value in group.items()})
        for group in (mean_lines.squareness, mean_lines.location)
    )
    return Calibration(machine, mean_lines.source, MappingProxyType(curves), squareness, location)


def as_drawn(machine: Machine) -> Calibration:
    """Return the same errors as recovered and drawn: curves as in the thesis, with their own constants."""
    rng = np.random.default_rng(SEED)
    curves = {name: _recovered(name) for name in PUBLISHED}
    curves |= {name: _drawn(name, peak, source, machine, rng) for name, (peak, source) in SHAPES.items()}
    ordered = {name: curves[name] for name in machine.motion_names}
    return Calibration(machine, SOURCE, MappingProxyType(ordered), MappingProxyType(SQUARENESS), MappingProxyType({}))


def _recovered(name: str) -> Curve:
    """Return a least-squares power series in u without constant, fitted to the printed rows, weighted by their printed digits."""
    column, degree, source = PUBLISHED[name]
    x = FIGURE_3_11[:, 0]
    error_um = (x * (column == 1) - FIGURE_3_11[:, column]) * 1e3
    # Six digits are printed: a resolution of 1 µm for a position (first two rows 0.1 µm), far finer for a small deviation.
    weight = 1.0 / 10.0 ** (np.floor(np.log10(np.abs(FIGURE_3_11[:, column]))) - 5.0)
    powers = (x[:, None] / 500.0) ** np.arange(1, degree + 1)
    fitted, *_ = np.linalg.lstsq(powers * weight[:, None], error_um * weight, rcond=None)
    in_x = np.polynomial.Polynomial([0.0, *fitted])
    in_u = in_x(np.polynomial.Polynomial([0.5, 0.5]))  # x / 500 = (u + 1) / 2
    return Curve(name, "um", (0.0, 500.0), "power", tuple(float(c) for c in in_u.coef), source=source)


def _drawn(name: str, peak: float, source: str, machine: Machine, rng: np.random.Generator) -> Curve:
    axis = machine.by_name[name[-1]]
    unit = "um" if name[2] in "XYZ" else "urad"
    source = f"illustrative; {source}"
    if axis.lower is None or axis.upper is None:
        orders = np.repeat([1, 2, 3], 2)
        harmonics = rng.normal(size=6) / orders**1.5
        fine = np.arange(0.0, 360.0, 0.5)
        curve = Curve(name, unit, (0.0, 360.0), "fourier", (0.0, *harmonics))
        coefficients = peak * harmonics / np.max(np.abs(curve(fine)))
        return _rounded(Curve(name, unit, (0.0, 360.0), "fourier", (0.0, *coefficients), None, source, True))
    domain = (axis.lower, axis.upper)
    u = np.linspace(-1.0, 1.0, 401)
    wave = rng.normal(size=6) / np.arange(1, 7) ** 1.2
    if name[2] == name[3]:  # positioning: a trend that carries the peak at the far end, and a wave
        series = chebyshev.chebadd([0.5, 0.5], 0.12 * wave / np.max(np.abs(chebyshev.chebval(u, wave))))
        if axis.upper <= 0.0:
            series = series * np.array([1, -1, 1, -1, 1, -1])
    else:
        series = wave
        if unit == "um" and axis.linear:  # straightness: its reference line is squareness
            line = np.polyfit(u, chebyshev.chebval(u, series), 1)
            series = chebyshev.chebsub(series, [line[1], line[0]])
    if name == "E_AX":  # largest at 300 mm
        series = chebyshev.poly2cheb([1.0 - 0.04, 0.4, -1.0, 0.0, 0.0, 0.0])
    values = chebyshev.chebval(u, series)
    series = series * peak / values[np.argmax(np.abs(values))]
    power = chebyshev.cheb2poly(series)
    return _rounded(Curve(name, unit, domain, "power", tuple(power), None, source, True))


def _rounded(curve: Curve) -> Curve:
    coefficients = tuple(float(f"{c:.5g}") for c in curve.coefficients)
    return Curve(curve.name, curve.unit, curve.domain, curve.basis, coefficients, None, curve.source, True)


if __name__ == "__main__":
    sys.stdout.write(calibration(Machine.load("dmu50")).to_yaml())
