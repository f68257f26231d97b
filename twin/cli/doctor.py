"""Command ``twin doctor``: check the installation and the numerical results on this computer."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time
from typing import Final

from twin.cli.shared.command import CommandResult, JsonOption, command, progress_bar
from twin.cli.shared.installation import Finding, browser, extras, packages, python, shown, size

SCHEMA: Final = "twin.doctor/1"
SLOW_START_S: Final = 5.0
"""Processor time before a command starts, above which start-up is reported as slow; two seconds are usual."""


@command("twin doctor", "twin doctor --json doctor.json")
def doctor(json_file: JsonOption = None) -> CommandResult:
    """Check the installation: packages, compiler, and a few computations with known results.

    The exit status is 0 if all required checks pass, and 3 if one fails. Optional parts may be missing.
    """
    from twin._common.records import json_form
    from twin.cli.shared.known_results import known_results

    began = process_time()
    checks: tuple[tuple[str, Callable[[], list[Finding]]], ...] = (
        ("Python", lambda: [python(), *packages(), *extras(), browser(), _cache(), *size(), _start(began)]),
        ("compiler", lambda: [_compiler()]),
        ("machine", known_results),
    )
    findings: list[Finding] = []
    clock = perf_counter()
    with progress_bar() as bar:
        for i, (stage, check) in enumerate(checks):
            bar(stage, i / len(checks))
            findings += check()
    taken = perf_counter() - clock
    failed = [finding.name for finding in findings if finding.status == "FAILED"]
    result = {"schema": SCHEMA, "ok": not failed, "failed": failed, "seconds": taken, "findings": json_form(findings)}
    return CommandResult(shown(findings, taken), lambda: result, met=not failed)


def _cache() -> Finding:
    from twin.compute.native import compiler

    place = compiler.folder()
    existing = next((one for one in (place, *place.parents) if one.exists()), Path("/"))
    try:
        with tempfile.TemporaryFile(dir=existing):
            return Finding("cache folder", "ok", f"{place}, writable")
    except OSError as error:
        remedy = "code is compiled again on every run; set XDG_CACHE_HOME to a writable folder"
        return Finding("cache folder", "missing", f"{place}: {error.strerror}", remedy)


def _start(seconds: float) -> Finding:
    if seconds > SLOW_START_S:
        remedy = "a slow disk or a virus scanner may be the cause: put the Python environment on a local disk"
        return Finding("start-up", "missing", f"{seconds:.1f} s of processor", remedy)
    return Finding("start-up", "ok", f"{seconds:.1f} s of processor before a command begins")


def _compiler() -> Finding:
    from twin.compute.native import compiler
    from twin.compute.native.compiler import SWITCH_VARIABLE, enabled, solver_description

    tool = compiler.find_compiler()
    if tool is None:
        remedy = "from 50,000 poses on, the inverse is about twenty times slower; apt install g++, or set CXX"
        return Finding("C++ compiler", "missing", "none of c++, g++, clang++, $CXX", remedy)
    if not enabled():
        return Finding(
            "C++ compiler", "missing", f"switched off by {SWITCH_VARIABLE}=0", f"unset {SWITCH_VARIABLE} to compile"
        )
    state = solver_description()  # compiles and runs a few lines, unless they are cached
    if not state.startswith("compiled"):
        remedy = "twin uses slower code without a compiler; repair the compiler, or set CXX to another"
        return Finding("C++ compiler", "missing", f"{tool.command[0]} fails: {state}", remedy)
    return Finding("C++ compiler", "ok", state)
