"""Diagnosis methods: each reads a measurement table and a machine file and writes ``diagnosis.json`` (schema twin.diagnosis/1)."""

from __future__ import annotations

import json
import shlex
import subprocess
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from tests.diagnosis import rivals
from tests.diagnosis.battery import UNHIDDEN, Key
from twin._common.errors import InputError
from twin._common.files import write_json
from twin._common.resources import one_blas_thread
from twin.diagnosis import diagnose
from twin.diagnosis.candidates.candidate import Candidate
from twin.diagnosis.problem import Problem
from twin.diagnosis.readings import readings
from twin.diagnosis.result import SCHEMA
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

LIMIT_S: Final = 900.0
BROKEN: Final = (ArithmeticError, LookupError, TypeError, ValueError)
"""Exceptions of a method that count as no answer and do not stop the other methods."""


class Method(ABC):
    """One method of diagnosis.

    Attributes:
        name: name in the table.
    """

    name: str

    @abstractmethod
    def diagnose(self, table: Path, machine: str, answer: Path, calibration: Path) -> str:
        """Write the diagnosis of a table to a file; return an error message, or an empty string.

        Args:
            table: the measurements.
            machine: name or path of the machine file.
            answer: JSON file to write.
            calibration: extended calibration to write, if the method supports it.
        """


@dataclass(frozen=True)
class Twin(Method):
    """Method `twin diagnose TABLE -m MACHINE --json ANSWER --extended CALIBRATION`, run in this process."""

    name: str = "twin"

    def diagnose(self, table: Path, machine: str, answer: Path, calibration: Path) -> str:
        own = Machine.load(machine)
        try:
            found = diagnose(Measurements.load(table, own), own, Calibration.default(own))
        except InputError as error:
            return str(error)
        write_json(answer, found.to_dict())
        found.extended.save(calibration)
        return ""


@dataclass(frozen=True)
class Rival(Method):
    """Standard method of `tests.diagnosis.rivals`: uses the whitened residuals and the candidates of `twin`; returns names only.

    Attributes:
        name: name in the table.
        names: function that returns the causes of a problem, given its candidates.
    """

    name: str
    names: Callable[[Problem, Sequence[Candidate]], tuple[Key, ...]]

    def diagnose(self, table: Path, machine: str, answer: Path, calibration: Path) -> str:
        own = Machine.load(machine)
        try:
            placed = readings(Measurements.load(table, own), own, Calibration.default(own), None)
        except InputError as error:
            return str(error)
        posed = placed.without(placed.bad)
        # Errors of the calibration itself are never hidden here, and are not possible candidates of a plain regression.
        choice = [candidate for candidate in posed.catalogue.candidates if candidate.effect not in UNHIDDEN]
        origin = {candidate.key: candidate.origin for candidate in choice}
        causes = [
            {"effect": key[0], "where": key[1], "origin": origin[key], "parameters": [], "equivalent": []}
            for key in self.names(posed.problem, choice)
        ]
        verdict = "explained" if causes else "consistent"
        said = {"schema": SCHEMA, "verdict": verdict, "causes": causes, "unexplained": None, "gain": None}
        write_json(answer, said)
        return ""


@dataclass(frozen=True)
class Command(Method):
    """Method run as an external program.

    Attributes:
        name: name in the table.
        command: command line with ``{table}``, ``{machine}``, ``{json}`` and optionally ``{calibration}`` as placeholders.
    """

    name: str
    command: str

    def diagnose(self, table: Path, machine: str, answer: Path, calibration: Path) -> str:
        files = {"table": str(table), "machine": machine, "json": str(answer), "calibration": str(calibration)}
        words = [word.format(**files) for word in shlex.split(self.command)]
        try:
            done = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT_S, check=False)
        except subprocess.TimeoutExpired:
            return f"no answer in {LIMIT_S:g} s"
        if not answer.exists():
            return (
                f"exit status {done.returncode}: {(done.stderr.strip().splitlines() or ['no JSON written'])[-1][:200]}"
            )
        return ""


BUILT_IN: Final[dict[str, Method]] = {
    one.name: one
    for one in (
        Twin(),
        Rival("stepwise-bic", rivals.stepwise_bic),
        Rival("stepwise-ebic", partial(rivals.stepwise_bic, extended=True)),
        Rival("lasso", rivals.lasso),
    )
}


def run_method(method: Method, table: Path, machine: str) -> dict[str, Any]:
    """Return ``seconds`` of wall time, ``error`` (empty if none), ``diagnosis`` and the text of ``calibration`` (None if none)."""
    with tempfile.TemporaryDirectory() as folder, one_blas_thread():
        answer = Path(folder) / "diagnosis.json"
        began = time.perf_counter()
        written = Path(folder) / "calibration.yaml"
        try:
            error = method.diagnose(table, machine, answer, written)
        except BROKEN as failure:
            error = f"{type(failure).__name__}: {failure}"
        seconds = time.perf_counter() - began
        diagnosis = None
        if not error:
            try:
                diagnosis = json.loads(answer.read_text(encoding="utf-8"))
            except ValueError as broken:
                error = f"not JSON: {broken}"
        text = written.read_text(encoding="utf-8") if written.exists() else None
    return {"method": method.name, "seconds": seconds, "error": error, "diagnosis": diagnosis, "calibration": text}
