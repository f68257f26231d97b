"""What `twin identify --json` wrote beside a calibration: how well the model fitted, and what the data could not tell."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from twin._common.errors import InputError
from twin._common.files import read_json
from twin.machine.calibration import Calibration

SCHEMA: Final = "twin.identification/1"
POINTS: Final = 201
"""At which `twin identify` looks for a peak."""
SAME: Final = 1e-6
"""Relative: the calibration's text carries all digits, so that other numbers are other estimates."""


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True)


@final
class Points(_Model):
    """How many rows of a table were used and set aside."""

    used: int
    set_aside: int


@final
class IdentifiedError(_Model):
    """One error, a curve with its order and peak or one number."""

    name: str
    order: int | None = None
    peak: float | None = None
    value: float | None = None


@final
class SaidUnidentified(_Model):
    """An error that the data could not show."""

    name: str
    reason: str


@final
class Misfit(_Model):
    """How well the model fitted: null without degrees of freedom, or without repeats."""

    rms_um: float
    reduced_chi2: float | None
    dof: float
    p_value: float | None
    lack_of_fit_p_value: float | None = None


@final
class Row(_Model):
    """A row of the table that was set aside."""

    line: int
    reason: str


@final
class IdentificationFile(_Model):
    """What `twin identify --json` writes, as far as a report of the machine needs it."""

    schema_: Literal["twin.identification/1"] = Field(alias="schema")
    machine: str
    data: str
    points: Points
    uncertainty: str
    errors: tuple[IdentifiedError, ...]
    not_identifiable: tuple[SaidUnidentified, ...]
    misfit: Misfit
    set_aside: tuple[Row, ...]
    notices: tuple[str, ...]
    converged: bool


@final
@dataclass(frozen=True)
class Identified:
    """The report of an identification.

    Attributes:
        path: the file.
        file: what is in it.
        others: errors to which it gives other numbers than the calibration has: it belongs to another one, or that was extended since.
    """

    path: Path
    file: IdentificationFile
    others: tuple[str, ...]

    @property
    def orders(self) -> dict[str, int]:
        """How many functions `identify` gave a curve beyond its datum, by name."""
        return {one.name: one.order for one in self.file.errors if one.order is not None}

    @property
    def rows(self) -> tuple[tuple[int, str], ...]:
        """Rows of the table that were set aside: line and reason."""
        return tuple((row.line, row.reason) for row in self.file.set_aside)

    @classmethod
    def load(cls, path: str | Path, calibration: Calibration) -> Identified:
        """Read the file.

        Args:
            path: what ``twin identify --json`` wrote.
            calibration: what it wrote beside it.

        Raises:
            InputError: it is no such file, or of another machine.
        """
        path = Path(path)
        try:
            found = IdentificationFile.model_validate(read_json(path, "what `twin identify --json` wrote"))
        except ValidationError as error:
            first = error.errors()[0]
            entry = ".".join(str(part) for part in first["loc"]) or "the file"
            raise InputError(
                f"`{entry}` does not fit",
                expected=f"what `twin identify --json` wrote, schema: {SCHEMA}",
                file=path,
                value=first["msg"],
            ) from None
        if found.machine != calibration.machine.name:
            raise InputError(
                "an identification of another machine",
                expected=calibration.machine.name,
                file=path,
                value=found.machine,
            )
        return cls(path, found, _others(found.errors, calibration))

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        told = self.file.model_dump(mode="json", exclude={"schema_", "machine", "errors"})
        return {"file": str(self.path), **told, "other_numbers_than_the_calibration": list(self.others)}


def _others(errors: tuple[IdentifiedError, ...], calibration: Calibration) -> tuple[str, ...]:
    """Names to which file and calibration give different numbers, or only one of them gives any."""
    told = {one.name: one.value if one.peak is None else one.peak for one in errors}
    own = {
        name: float(np.abs(curve(np.linspace(*curve.domain, POINTS))).max())
        for name, curve in calibration.curves.items()
    }
    own |= dict(calibration.squareness) | dict(calibration.location)
    return tuple(
        name
        for name in dict.fromkeys((*told, *own))
        if (mine := own.get(name)) is None
        or (theirs := told.get(name)) is None
        or abs(mine - theirs) > SAME * max(abs(mine), abs(theirs))
    )
