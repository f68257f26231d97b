"""Squareness of two linear axes from the reference lines of two straightness measurements, with the sign of ISO 230-1:2012.

Both straightnesses are in the same plane and relative to the same reference: an artefact with two legs, or an instrument that
was not moved in between. The sign is that of the direction of the second axis, rotated right-handed about the third::

    E_XY −= y·E_C0Y        E_XZ += z·E_B0Z        E_YZ −= z·E_A0Z

so a positive ``E_C0Y`` opens the angle from +X to +Y beyond 90°. A common rotation of the reference has no influence.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np

from twin._common.errors import InputError
from twin.measurement.evaluation.straightness import ReferenceLine, Straightness

LineKind = Literal["least squares", "end point", "minimum zone"]
PAIRS: Final = {
    "E_C0Y": ("E_YX", "E_XY", -1.0),
    "E_B0Z": ("E_ZX", "E_XZ", +1.0),
    "E_A0Z": ("E_ZY", "E_YZ", -1.0),
}
"""Squareness → straightness of the datum axis, of the other axis, and the sign of the sum of their slopes."""


@final
@dataclass(frozen=True)
class SquarenessError:
    """Squareness of an axis relative to another.

    Attributes:
        name: ``E_C0Y``, ``E_B0Z`` or ``E_A0Z``.
        value_urad: the error; right-handed, see the module.
        u_urad: its standard uncertainty, or None if the lines have none.
        line: kind of the reference lines.
        datum_slope_urad, slope_urad: slopes of the lines of the datum axis and of the other axis.
    """

    name: str
    value_urad: float
    u_urad: float | None
    line: LineKind
    datum_slope_urad: float
    slope_urad: float


def squareness(
    datum: Straightness,
    other: Straightness,
    *,
    line: LineKind = "least squares",
    artefact_urad: float = 0.0,
    u_artefact_urad: float = 0.0,
) -> SquarenessError:
    """Evaluate the squareness of an axis relative to its datum axis. The two measurements are taken as independent.

    Args:
        datum: straightness of the datum axis: ``E_YX`` or ``E_ZX`` of X, ``E_ZY`` of Y.
        other: straightness of the other axis: ``E_XY``, ``E_XZ`` or ``E_YZ``.
        line: kind of the reference lines.
        artefact_urad: the artefact's own squareness error with the same sign, from its certificate.
        u_artefact_urad: standard uncertainty of that.

    Raises:
        InputError: names that are not a pair, or invalid values of the artefact.
    """
    name = next(
        (name for name, (first, second, _) in PAIRS.items() if (first, second) == (datum.name, other.name)), None
    )
    if name is None:
        pairs = "; ".join(f"{first} and {second}" for first, second, _ in PAIRS.values())
        raise InputError(
            "not two straightnesses in one plane, datum axis first",
            expected=pairs,
            value=f"{datum.name} and {other.name}",
        )
    if not (np.isfinite(artefact_urad) and np.isfinite(u_artefact_urad) and u_artefact_urad >= 0.0):
        raise InputError(
            "invalid error of the artefact",
            expected="finite µrad, u not negative",
            value=(artefact_urad, u_artefact_urad),
        )
    first, second = _of_kind(datum, line), _of_kind(other, line)
    u_first, u_second = first.u_slope_urad, second.u_slope_urad
    u = None if u_first is None or u_second is None else float(np.sqrt(u_first**2 + u_second**2 + u_artefact_urad**2))
    return SquarenessError(
        name=name,
        value_urad=PAIRS[name][2] * (first.slope_urad + second.slope_urad) + artefact_urad,
        u_urad=u,
        line=line,
        datum_slope_urad=first.slope_urad,
        slope_urad=second.slope_urad,
    )


def _of_kind(measured: Straightness, kind: str) -> ReferenceLine:
    found = next((line for line in measured.lines if line.kind == kind), None)
    if found is None:
        raise InputError("unknown reference line", expected=", ".join(line.kind for line in measured.lines), value=kind)
    return found
