"""Names of the members of each family, and where each member is defined.

This module imports nothing of `twin`: options and shell completion list names without importing what has them. A package makes its
tuple of members from its table with `members`, so that a name is listed in one place.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from importlib import import_module
from typing import Any, Final, Literal, get_args

INSTRUMENTS: Final = {
    "tracker": "points:AT960",
    "tracker-absolute": "points:AT960_ABSOLUTE",
    "interferometer": "lengths:TrackingInterferometer",
    "linear-interferometer": "lengths:LinearInterferometer",
    "level": "points:Level",
    "probe": "points:TouchProbe",
    "r-test": "points:RTest",
    "ball-bar": "lengths:BallBar",
    "cmm": "lengths:CMM",
}
"""Instruments whose readings a measurement table can contain: `twin.measurement.instruments`."""
MEASURED_FORMATS: Final = {
    "contacts": "contact_table:ContactTable",
    "linuxcnc": "linuxcnc:LinuxCncProbeLog",
    "tf5245": "tf5245:Tf5245",
    "heidenhain": "heidenhain:HeidenhainContacts",
    "renishaw-ballbar": "renishaw_ballbar:RenishawBallbar",
    "renishaw-laser": "renishaw_laser:RenishawLaser",
    "tracker": "tracker:TrackerExport",
}
"""Formats of measured data of other programs: `twin.measurement.formats`."""
TABLE_FORMATS: Final = {
    "linuxcnc": "linuxcnc:LinuxCnc",
    "heidenhain": "heidenhain:HeidenhainTables",
    "siemens": "siemens:Siemens",
    "isg": "isg:Isg",
    "grid": "grid:SpatialGrid",
    "siemens_eec": "siemens_eec:SiemensEec",
    "klipper": "skew:Klipper",
    "marlin": "skew:Marlin",
    "reprapfirmware": "skew:RepRapFirmware",
    "matrixkins": "skew:MatrixKins",
}
"""Formats of compensation tables: `twin.controls.formats`."""
KINEMATICS_FORMATS: Final = {
    "linuxcnc-trt": "linuxcnc_trt:LinuxCncTrt",
    "siemens-chain": "siemens_chain:SiemensChain",
    "siemens-trafo5": "siemens_trafo5:SiemensTrafo5",
    "heidenhain-kinematics": "heidenhain_table:HeidenhainTable",
    "fanuc-five-axis": "fanuc:FanucTable",
}
"""Formats of a control's kinematics: `twin.controls.kinematics`."""
EFFECTS: Final = {
    "reversal": "reversal:REVERSAL",
    "zero_offset": "location:ZERO_OFFSET",
    "pitch_error": "pitch_error:PITCH_ERROR",
    "scale_step": "scale_step:SCALE_STEP",
    "thermal_expansion": "thermal_expansion:THERMAL_EXPANSION",
    "scale_growth": "thermal_expansion:SCALE_GROWTH",
    "scale_drift": "thermal_drift:SCALE_DRIFT",
    "reversal_curve": "reversal:REVERSAL_CURVE",
    "squareness": "location:SQUARENESS",
    "axis_location": "location:AXIS_LOCATION",
    "positioning": "error_motion:POSITIONING",
    "straightness": "error_motion:STRAIGHTNESS",
    "angular_error_motion": "error_motion:ANGULAR_ERROR_MOTION",
    "error_motion": "error_motion:ROTARY_ERROR_MOTION",
    "harmonic": "harmonic:HARMONIC",
    "cross_axis": "cross_axis:CROSS_AXIS",
    "thermal_growth": "thermal_growth:THERMAL_GROWTH",
    "thermal_lag": "thermal_growth:THERMAL_LAG",
    "thermal_tilt": "thermal_growth:THERMAL_TILT",
    "thermal_drift": "thermal_drift:THERMAL_DRIFT",
    "spindle_growth": "spindle_growth:SPINDLE_GROWTH",
    "table_load": "table_load:TABLE_LOAD",
    "base_tilt": "base_tilt:BASE_TILT",
    "gravity_compliance": "gravity_compliance:GRAVITY_COMPLIANCE",
    "payload": "gravity_compliance:PAYLOAD",
    "carried_load": "gravity_compliance:CARRIED_LOAD",
}
"""Effects of a machine: `twin.model.effects`."""
ARTEFACTS: Final = {
    "diagonals": "diagonals:Diagonals",
    "square": "faces:Square",
    "block": "faces:GaugeBlock",
    "straightedge": "faces:Straightedge",
    "scale-bar": "balls:ScaleBar",
    "ball-plate": "balls:BallPlate",
}
"""Artefacts and simple instruments for squareness and scale: `twin.standards.artefacts`."""
LIVE_FORMATS: Final = ("linuxcnc-kinematics",)
"""Kinematics modules that a control executes in every cycle: `twin.compensation.live`."""
SEQUENCES: Final = ("best", "turns", "ak1", "ak2", "ak4", "bk1", "bk2", "bk4", "circles")
"""Measuring sequences: `twin.planning.sequences`."""
SEQUENCE_INSTRUMENTS: Final = ("probe", "r-test", "ball-bar")
"""Instruments that measure the tool relative to the table: measuring sequences are planned for them."""
DRIFTS: Final = ("environment", "spindle", "axes")
"""Drift tests after ISO 230-3: `twin.planning.drift`."""
DRIFT_INSTRUMENTS: Final = ("probe", "r-test", "displacement")
"""Touch probe and sphere, R-test, or displacement sensors around a mandrel."""


class ProgramLanguage(StrEnum):
    """Languages of NC programs (`twin.nc`)."""

    iso = "iso"
    heidenhain = "heidenhain"
    apt = "apt"


PROGRAM_SUFFIXES: Final[Mapping[str, tuple[str, ...]]] = {
    ProgramLanguage.iso: (
        ".nc",
        ".ngc",
        ".tap",
        ".mpf",
        ".spf",
        ".iso",
        ".eia",
        ".ptp",
        ".cnc",
        ".gcode",
        ".min",
        ".txt",
    ),
    ProgramLanguage.heidenhain: (".h", ".txt"),
    ProgramLanguage.apt: (".cls", ".apt", ".txt"),
}
"""File name suffixes of each program language (`twin.nc`), in small letters, with the dot. One of several languages tells nothing."""


def members(package: str, table: Mapping[str, str]) -> tuple[Any, ...]:
    """Import the members of a family, in the order of their table; as `member`."""
    return tuple(member(package, table, name) for name in table)


def member(package: str, table: Mapping[str, str], name: str) -> Any:
    """Import one member of a family, which the table gives as module and attribute: the member, its class, or a tuple with it."""
    module, attribute = table[name].split(":")
    found = getattr(import_module(f"{package}.{module}"), attribute)
    some = found if isinstance(found, tuple) else (found() if isinstance(found, type) else found,)
    for one in some:
        if one.name == name:
            return one
    raise LookupError(f"{package}.{module}.{attribute} has no member of the name {name!r}")


# --- Languages of reports -------------------------------------------------------------------------


class Language(StrEnum):
    """Language of a report."""

    en = "en"
    de = "de"


# --- Classes of ISO/TR 16907 ----------------------------------------------------------------------

BasicClass = Literal["L-POS", "L-STR", "L-SQU", "L-ANG", "R-POS", "R-RAX", "R-POR", "R-ANG"]
BASIC: Final[tuple[str, ...]] = get_args(BasicClass)
"""Basic classes: every error motion belongs to exactly one of them."""
COMBINED: Final = {
    "L-VOL": ("L-POS", "L-STR", "L-SQU", "L-ANG"),
    "L-VOL+": ("L-POS", "L-STR", "L-SQU", "L-ANG", "FOR"),
    "R-VOL": ("R-POS", "R-RAX", "R-POR", "R-ANG"),
    "R-VOL+": ("R-POS", "R-RAX", "R-POR", "R-ANG", "FOR"),
}
NAMES: Final = (*BASIC, *COMBINED, "FOR")
