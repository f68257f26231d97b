"""The entries of a calibration file, as pydantic checks them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from twin.control import BasicClass


class CurveEntry(BaseModel):
    """One error motion."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    unit: str
    domain: tuple[float, float]
    basis: str
    coefficients: Annotated[tuple[float, ...], Field(min_length=1)]
    covariance: tuple[tuple[float, ...], ...] | None = None
    illustrative: bool = False
    source: str = ""


class ColumnEntry(BaseModel):
    """One column of an empirical effect."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    column: str
    functions: Literal["half_waves", "whole_turns", "direction"]
    order: int | None = None
    range: tuple[float, float] | None = None


class EffectEntry(BaseModel):
    """One effect; the last four only of an empirical one."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    effect: str
    where: str
    parameters: dict[str, float]
    cause: Literal["unknown"] | None = None
    note: str = ""
    along: Literal["base", "tool", "work"] | None = None
    columns: tuple[ColumnEntry, ...] = ()


class CovarianceEntry(BaseModel):
    """Covariance of all parameters together."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    parameters: tuple[str, ...]
    lower: str


class TableFileEntry(BaseModel):
    """One table of the control."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    file: str
    format: str
    classes: tuple[BasicClass, ...]
    sha256: str


class ControlEntry(BaseModel):
    """What the control corrects."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    errors_are: Literal["uncorrected", "remaining"]
    tables: Annotated[tuple[TableFileEntry, ...], Field(min_length=1)]


class CalibrationFile(BaseModel):
    """A calibration file."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    schema_: Literal["twin.calibration/1"] = Field(alias="schema")
    machine: str
    source: str
    datum: str | None = None
    settled: bool = True
    simulated: bool = False
    curves: dict[str, CurveEntry] = {}
    squareness: dict[str, float] = {}
    location: dict[str, float] = {}
    covariance: CovarianceEntry | None = None
    effects: tuple[EffectEntry, ...] = ()
    control: ControlEntry | None = None
