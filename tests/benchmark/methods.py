"""The methods: each gets a measurement table and a machine file, and writes ``diagnosis.json`` (contract §4)."""

from __future__ import annotations

import json
import shlex
import subprocess
import tempfile
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from threadpoolctl import threadpool_limits

from twin.calibration import Calibration
from twin.diagnosis import diagnose
from twin.errors import InputError
from twin.files import write_json
from twin.machine import Machine
from twin.measurement import load

LIMIT_S: Final = 900.0


class Method(ABC):
    """One method of diagnosis.

    Attributes:
        name: in the table.
    """

    name: str

    @abstractmethod
    def diagnose(self, table: Path, machine: str, answer: Path) -> str:
        """Write the diagnosis of a table to a file; return why there is none, or nothing."""


@dataclass(frozen=True)
class Twin(Method):
    """`twin diagnose TABLE -m MACHINE --json ANSWER`, in this process."""

    name: str = "twin"

    def diagnose(self, table: Path, machine: str, answer: Path) -> str:
        own = Machine.load(machine)
        try:
            found = diagnose(load(table, own), own, Calibration.default(own))
        except InputError as error:
            return str(error)
        write_json(answer, found.to_dict())
        return ""


@dataclass(frozen=True)
class Command(Method):
    """Any program.

    Attributes:
        name: in the table.
        command: its words, with ``{table}``, ``{machine}`` and ``{json}`` in place of the files.
    """

    name: str
    command: str

    def diagnose(self, table: Path, machine: str, answer: Path) -> str:
        files = {"table": str(table), "machine": machine, "json": str(answer)}
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


BUILT_IN: Final[dict[str, Method]] = {"twin": Twin()}


def asked(method: Method, table: Path, machine: str) -> dict[str, Any]:
    """Return ``seconds`` of wall time, ``error`` (empty if there is none) and ``diagnosis`` (None if there is none)."""
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(limits=1, user_api="blas"):
        answer = Path(folder) / "diagnosis.json"
        began = time.perf_counter()
        error = method.diagnose(table, machine, answer)
        seconds = time.perf_counter() - began
        diagnosis = None
        if not error:
            try:
                diagnosis = json.loads(answer.read_text(encoding="utf-8"))
            except ValueError as broken:
                error = f"not JSON: {broken}"
    return {"method": method.name, "seconds": seconds, "error": error, "diagnosis": diagnosis}
