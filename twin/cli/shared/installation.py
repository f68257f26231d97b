"""Check which packages are installed and can be imported. This module imports none of them, so it works if one is broken.

Every command imports this module: what only the checks need is imported by them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from time import perf_counter
from types import MappingProxyType
from typing import Final, Literal, NoReturn, final

from twin.cli.shared.terminal import accept_any_text, echo, print_error

BAD_INPUT: Final = 2
NOT_ALL_MET: Final = 3
INTERRUPTED: Final = 130

NEEDED: Final[Mapping[str, str]] = MappingProxyType(
    {
        "casadi": "casadi",
        "cloudpickle": "cloudpickle",
        "coal": "coal",
        "jinja2": "jinja2",
        "joblib": "joblib",
        "meshcat": "meshcat.geometry",
        "numpy": "numpy",
        "openpyxl": "openpyxl",
        "pin": "pinocchio",
        "pydantic": "pydantic",
        "pyyaml": "yaml",
        "rich": "rich.console",
        "scipy": "scipy.linalg, scipy.optimize, scipy.special",
        "threadpoolctl": "threadpoolctl",
        "typer": "typer",
        "u-msgpack-python": "umsgpack",
    }
)
"""Required packages, each with the modules to import."""
NEEDED_LATER: Final = frozenset({"meshcat", "openpyxl", "u-msgpack-python"})
"""Required packages that only the 3D scene and the import of workbooks use."""
OPTIONAL: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "matplotlib": ("matplotlib.figure", "pictures: pip install 'twin[plots]'"),
        "dask": ("dask", "a cluster: pip install 'twin[cluster]'"),
        "distributed": ("distributed", "a cluster: pip install 'twin[cluster]'"),
    }
)
"""Optional packages, each with a module to import and its use."""
IMPORT_FAILURES: Final = (
    ImportError, AttributeError, LookupError, OSError, RuntimeError, SyntaxError, SystemError, TypeError, ValueError
)  # fmt: skip
"""Exceptions that the import of a broken package may raise."""
IMPORT_S: Final = 120.0
"""Timeout of the import of a package, s."""
BROWSERS: Final = ("chromium", "chromium-browser", "google-chrome")
EARLIEST: Final = (3, 11)
LITTLE_MEMORY_GB: Final = 2.0
"""`identify` and `diagnose` take 1.2 GB for 100,000 points."""


@final
@dataclass(frozen=True)
class Finding:
    """Result of one check."""

    name: str  # what was checked
    status: Literal["ok", "missing", "FAILED"]  # ``ok``; ``missing``: something optional is absent; ``FAILED``
    detail: str  # what was found
    remedy: str = ""  # what to do; empty if nothing is needed


@cache
def imports_all() -> bool:
    """Return whether all installed packages can be imported, tested together in a child process."""
    return _failure(", ".join(_modules().values())) is None


@cache
def broken() -> Mapping[str, str]:
    """Return the installed packages that cannot be imported, each with the reason; each in a process that the import may crash."""
    if imports_all():
        return {}
    from concurrent.futures import ThreadPoolExecutor

    modules = _modules()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        reasons = dict(zip(modules, pool.map(_failure, modules.values()), strict=True))
    return {name: reason for name, reason in reasons.items() if reason is not None}


def can_start() -> bool:
    """Return whether all packages that a command imports at start-up can be imported."""
    return not _not_installed() and not (broken().keys() & NEEDED.keys()) - NEEDED_LATER


def exit_with_import_error(error: BaseException) -> NoReturn:
    """Exit with status 2 after a failed import, and name the packages; if all can be imported, the defect is twin's: raise."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, KeyboardInterrupt):  # a package that was being imported made another exception of it
            raise KeyboardInterrupt from error
        cause = cause.__cause__ or cause.__context__
    accept_any_text()
    names: dict[str, list[str]] = {}
    for name, reason in broken().items():
        names.setdefault(reason, []).append(name)
    missing = [f"{name} is not installed" for name in _not_installed()]
    missing += [f"{', '.join(some)} cannot be imported ({reason})" for reason, some in names.items()]
    if not missing:
        raise error
    print_error(f"twin: {'; '.join(missing)}; expected working packages: run twin doctor")
    sys.exit(BAD_INPUT)


def exit_with_findings() -> NoReturn:
    """Print the checks of `twin doctor` that need no packages, and exit with the status of a failed check."""
    accept_any_text()
    clock = perf_counter()
    findings = [python(), *packages(), *extras(), browser(), *size()]
    echo(shown(findings, perf_counter() - clock), end="")
    echo("machine, compiler and JSON: not checked, because they need the packages that failed")
    sys.exit(NOT_ALL_MET)


def shown(findings: Sequence[Finding], seconds: float) -> str:
    """Return the findings, one per line, and a summary."""
    lines = []
    for finding in findings:
        lines.append(f"{finding.status:<8}{finding.name:<26}{finding.detail}")
        if finding.remedy:
            lines.append(f"{'':<10}{finding.remedy}")
    failed = [finding.name for finding in findings if finding.status == "FAILED"]
    missing = [finding.name for finding in findings if finding.status == "missing"]
    summary = f"FAILED: {', '.join(failed)}" if failed else "all required checks passed"
    summary += f"; optional, missing: {', '.join(missing)}" if missing else ""
    return "\n".join([*lines, "", f"{len(findings)} checks in {seconds:.1f} s: {summary}", ""])


def python() -> Finding:
    """Check the version of Python."""
    import platform

    detail = f"{platform.python_version()} ({sys.executable}), twin {_version('twin') or 'not installed'}"
    if sys.version_info < EARLIEST:
        return Finding("Python", "FAILED", detail, f"install Python {'.'.join(map(str, EARLIEST))} or newer")
    return Finding("Python", "ok", detail)


def packages() -> list[Finding]:
    """Check the required packages; each that fails is a finding of its own."""
    reasons = broken()
    findings = [
        Finding(name, "FAILED", f"{_version(name)} cannot be imported: {reasons[name]}", _reinstall(name))
        for name in NEEDED
        if name in reasons
    ]
    absent = _not_installed()
    if absent:
        findings.append(
            Finding("packages", "FAILED", f"not installed: {', '.join(absent)}", "install twin again: pip install .")
        )
    good = ", ".join(f"{name} {_version(name)}" for name in NEEDED if name not in absent and name not in reasons)
    return findings if absent else [*findings, Finding("packages", "ok", good)]


def extras() -> list[Finding]:
    """Check the optional packages."""
    findings = []
    for name, (_, use) in OPTIONAL.items():
        installed, reason = _version(name), broken().get(name)
        if installed is None:
            findings.append(Finding(name, "missing", "not installed", f"for {use}"))
        elif reason is not None:
            findings.append(Finding(name, "FAILED", f"{installed} cannot be imported: {reason}", _reinstall(name)))
        else:
            findings.append(Finding(name, "ok", installed))
    return findings


def browser() -> Finding:
    """Look for the browser that the tests of the scene use."""
    import shutil

    for name in BROWSERS:
        path = shutil.which(name)
        if path is not None:
            return Finding("Chromium", "ok", path)
    return Finding(
        "Chromium", "missing", "not found", "needed only for the browser test of the scene; any browser shows the pages"
    )


def size() -> list[Finding]:
    """Return findings on processor cores and memory."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    findings = [Finding("processor cores", "ok", f"{cores}")]
    try:
        total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
    except (AttributeError, ValueError, OSError):
        return [*findings, Finding("memory", "missing", "not reported by this system")]
    if total < LITTLE_MEMORY_GB:
        remedy = "a table of 100,000 readings takes 1.2 GB; use smaller tables"
        return [*findings, Finding("memory", "missing", f"{total:.1f} GB", remedy)]
    return [*findings, Finding("memory", "ok", f"{total:.1f} GB")]


def _version(name: str) -> str | None:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _not_installed() -> list[str]:
    return [name for name in NEEDED if _version(name) is None]


def _reinstall(name: str) -> str:
    return f"install it again: pip install --force-reinstall {name}"


def _modules() -> dict[str, str]:
    every = {**NEEDED, **{name: modules for name, (modules, _) in OPTIONAL.items()}}
    return {name: modules for name, modules in every.items() if _version(name) is not None}


def _failure(modules: str) -> str | None:
    """Return, in one line, why the import of modules fails in a child process; None if it succeeds."""
    import subprocess

    words = [sys.executable, "-P", "-c", f"import {modules}"]
    try:
        ended = subprocess.run(words, capture_output=True, text=True, errors="replace", timeout=IMPORT_S)
    except subprocess.TimeoutExpired:
        return f"timeout after {IMPORT_S:g} s"
    if ended.returncode == 0:
        return None
    lines = ended.stderr.strip().splitlines()
    return lines[-1] if lines else f"the process ended with status {ended.returncode}"
