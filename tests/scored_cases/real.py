"""Real data sets and their expected results, which were published or computed by least squares independently of `twin`.

Sets that need their own calibration before a diagnosis (the UR10) are not included, because a method gets only a table and a machine
file.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from tests.conftest import SHARED
from tests.real.__main__ import SetUpFit, Table, given, of_plate, of_stage, rms_um
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.model.calibration import Calibration

REAL: Final = SHARED / "data" / "real"
Said = Mapping[str, Any]
Files = Callable[[Path], tuple[Path, Path]]


@dataclass(frozen=True)
class Answer:
    """Answer of a method to a data set.

    Attributes:
        diagnosis: its JSON; None if it refused the data.
        calibration: extended calibration that it wrote, or None.
        table, machine: its input files.
    """

    diagnosis: Said | None
    calibration: Path | None
    table: Path
    machine: Path

    @property
    def causes(self) -> list[Said]:
        return [] if self.diagnosis is None else list(self.diagnosis["causes"])

    @property
    def keys(self) -> list[tuple[str, str]]:
        """Effect and location of every cause."""
        return [(cause["effect"], cause["where"]) for cause in self.causes]

    def cause(self, effect: str, where: str) -> Said | None:
        """Return the cause that names an effect, itself or in `equivalent`; None if there is none."""
        for cause in self.causes:
            if {"effect": effect, "where": where} in [{k: cause[k] for k in ("effect", "where")}, *cause["equivalent"]]:
                return cause
        return None

    def size(self, effect: str, where: str) -> float:
        """Return the first parameter of the cause of this name; NaN if there is none."""
        for cause in self.causes:
            if (cause["effect"], cause["where"]) == (effect, where) and cause["parameters"]:
                return float(cause["parameters"][0]["value"])
        return float("nan")

    def u(self, effect: str, where: str) -> float:
        """Return the standard uncertainty of `size`."""
        cause = self.cause(effect, where)
        return float(cause["parameters"][0]["u"]) if cause and cause["parameters"] else float("nan")

    def held_out(self) -> tuple[float, float]:
        """Return the residual on held-out data before and after, µm per coordinate; NaN if not given."""
        held = ((self.diagnosis or {}).get("gain") or {}).get("held_out") or {}
        before, after = (held.get(f"rms_{when}_um") for when in ("before", "after"))
        return float("nan") if before is None else before, float("nan") if after is None else after


Check = Callable[[Answer], bool]


@dataclass(frozen=True)
class RealSet:
    """A real data set and the checks of an answer to it.

    Attributes:
        name: name in the table.
        folder: name of its folder among the real data sets.
        files: function that returns table and machine file, and may write them into a folder.
        checks: check of an answer, by its description.
    """

    name: str
    folder: str
    files: Files
    checks: Mapping[str, Check]

    def there(self) -> bool:
        """Return whether its files are available."""
        return (REAL / self.folder).exists()

    def failed(self, answer: Answer) -> list[str]:
        """Return the descriptions of the failed checks."""
        return [words for words, check in self.checks.items() if not check(answer)]


def _without(files: Files, *columns: str) -> Files:
    """Return files whose table lacks some columns."""

    def written(folder: Path) -> tuple[Path, Path]:
        table, machine = files(folder)
        with table.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.reader(file))
        kept = [i for i, name in enumerate(rows[0]) if not name.startswith(columns)]
        path = folder / f"without-{table.name}"
        with path.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows([[row[i] for i in kept] for row in rows])
        return path, machine

    return written


def _frame(want: float) -> dict[str, Check]:
    """Return the checks for thermal growth of the printer's frame, µm/K, optionally of its bed, and no other cause."""

    def small(answer: Answer) -> bool:
        left = (answer.diagnosis or {}).get("unexplained")
        return answer.diagnosis is not None and (left is None or (left["share"] or 0.0) <= 0.1)

    return {
        f"frame {want} ± 3 µm/K": lambda a: abs(abs(a.size("thermal_growth", "X by frame")) - want) < 3.0,
        "no cause but frame and bed": lambda a: (
            bool(a.causes) and {where for _, where in a.keys} <= {"X by frame", "X by bed"}
        ),
        "at most a tenth unexplained": small,
    }


def _leaves_no_more(answer: Answer) -> bool:
    """Return whether the residual with the written calibration, after the best rigid fit, is not above that of the nominal machine."""
    if answer.calibration is None:
        return False
    machine = Machine.load(answer.machine)
    table = Table.read(answer.table, machine)
    try:
        both = [Calibration.zero(machine), Calibration.load(answer.calibration, machine)]
        before, after = (rms_um(SetUpFit(table, one).residual(table))[0] for one in both)
    except InputError:
        return False
    return after <= before


def _near(effect: str, where: str, want: float, off: float) -> Check:
    return lambda a: abs(a.size(effect, where) - want) < off


def _near_in_u(effect: str, where: str, want: float, own_u: float) -> Check:
    """Return a check that a size agrees within three combined standard uncertainties."""
    return lambda a: abs(a.size(effect, where) - want) < 3.0 * np.hypot(a.u(effect, where), own_u)


def _one_drift(answer: Answer) -> bool:
    return sum(effect in ("station_drift", "thermal_drift") for effect, _ in answer.keys) == 1


def _promises_nothing(answer: Answer) -> bool:
    """Return whether the answer has no curve through five positions, or claims no accuracy between them."""
    point = ((answer.diagnosis or {}).get("gain") or {}).get("tool_point") or {}
    claims = any(effect == "positioning" for effect, _ in answer.keys)
    return not claims or (point.get("after_um") is not None and point["after_um"] >= 10.0)


def _gravity(answer: Answer) -> bool:
    found = [cause for cause in answer.causes if cause["effect"] == "gravity_compliance"]
    sizes = [abs(cause["parameters"][0]["value"]) for cause in found if cause["parameters"]]
    return any(cause["where"] in ("J2", "J3") for cause in found) and all(size <= 100.0 for size in sizes)


def _named(*keys: tuple[str, str]) -> Check:
    return lambda a: set(keys) <= set(a.keys)


_PLATE: Final[dict[str, Check]] = {
    "squareness 64.3 ± 1.4 µrad": _near_in_u("squareness", "E_C0Y", 64.3, 1.4),
    "both scales": _named(("positioning", "E_XX"), ("positioning", "E_YY")),
    "at most 5.2 µm remaining in the plane": lambda a: (
        ((a.diagnosis or {}).get("gain") or {}).get("rms_after_um", 1e9) < 5.25 / 2**0.5
    ),
    "the calibration does not increase the residual": _leaves_no_more,
}
_PLATE_2003: Final[dict[str, Check]] = {
    "answers": lambda a: a.diagnosis is not None,
    "squareness 3 ± 2 µrad": lambda a: not abs(a.size("squareness", "E_C0Y") - 3.0) > 6.0,
    "the calibration does not increase the residual": _leaves_no_more,
}
REAL_SETS: Final = (
    *(
        RealSet(
            f"printer {run}, {tag}", "voron-frame", change(given("voron-frame", f"{run}.csv", "z.yaml")), _frame(want)
        )
        for run, want in (("run2", 27.5), ("run3", 33.35))
        for tag, change in (("no time", lambda files: _without(files, "time_s")), ("with time", lambda files: files))
    ),
    RealSet(
        "printer, dead sensor",
        "voron-frame",
        given("voron-frame", "run3_dead_sensor.csv", "z.yaml"),
        {"refused": lambda a: a.diagnosis is None},
    ),
    RealSet("plate of 2011", "plates", of_plate, _PLATE),
    RealSet("plate of 2011, no uncertainties or places", "plates", _without(of_plate, "u_", "place_"), _PLATE),
    RealSet("plate of 2003", "plate-2003", given("plate-2003", "plate.csv", "drill.yaml"), _PLATE_2003),
    RealSet(
        "plate of 2003, free place",
        "plate-2003",
        given("plate-2003", "plate_free_place.csv", "drill.yaml"),
        _PLATE_2003,
    ),
    *(
        RealSet(
            f"stage {axis}",
            "stage-iso230-2",
            of_stage(axis),
            {
                f"reversal {want} µm": _near_in_u("reversal", "X", want, 0.0),
                "one drift": _one_drift,
                "held out less than 0.15": lambda a: a.held_out()[1] < 0.15 * a.held_out()[0],
            },
        )
        for axis, want in (("x", -25.37), ("y", -12.77))
    ),
    RealSet(
        "stage z",
        "stage-z",
        given("stage-z", "run.csv", "stage.yaml"),
        {
            "reversal −1.6 ± 1 µm": _near("reversal", "X", -1.6, 1.0),
            "nothing promised between positions": _promises_nothing,
        },
    ),
    RealSet(
        "robot IRB120",
        "abb-irb120",
        given("abb-irb120", "tool2.csv", "irb120.yaml"),
        {
            "read-back": lambda a: any(effect == "read_back" for effect, _ in a.keys),
            "no reversal of J1": lambda a: a.diagnosis is not None and a.cause("reversal", "J1") is None,
            "gravity at J2 or J3, at most 100": _gravity,
            "held out at most 125 µm in space": lambda a: a.held_out()[1] <= 125.0 / 3**0.5,
        },
    ),
)


def summary(failed: list[str], of: RealSet, answer: Answer, error: str) -> list[str]:
    """Return a row of the table: set, verdict, checks passed, failed checks, causes."""
    verdict = answer.diagnosis["verdict"] if answer.diagnosis else f"refused: {error[:60]}"
    causes = ", ".join(f"{effect} {where}" for effect, where in answer.keys[:6])
    passed = f"{len(of.checks) - len(failed)} of {len(of.checks)}"
    return [of.name, verdict, "yes" if not failed else "no", passed, "; ".join(failed) or "–", causes or "–"]


HEADER: Final = ["set", "verdict", "right", "checks", "failed", "causes"]
