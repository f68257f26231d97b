"""The C++ compiler of this computer, if there is one."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final, final

CANDIDATES: Final = ("c++", "g++", "clang++")
FLAGS: Final = (
    "-std=c++17",
    "-O2",
    "-march=native",
    "-ffp-contract=fast",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-shared",
    "-fPIC",
)
"""Compiler flags. Not ``-ffast-math``: at most 6 % faster, and it would remove comparisons with not-a-number."""
GUARD_PROGRAM: Final = """
import os, signal, subprocess, sys, threading

def end_with_parent():
    os.read(int(sys.argv[1]), 1)  # returns when no process holds the other end
    os.killpg(0, signal.SIGKILL)

threading.Thread(target=end_with_parent, daemon=True).start()
sys.exit(subprocess.call(sys.argv[2:]))
"""
"""Program that runs the compiler in its own process group and kills the group when the parent process has ended."""
COMPILE_TIMEOUT_S: Final = 120.0
"""Timeout of the compiler, which takes one or two seconds."""


class CompilerError(Exception):
    """Compilation failed; the message is the compiler's."""


@final
@dataclass(frozen=True)
class Compiler:
    """A C++ compiler.

    Attributes:
        command: its command line.
        version: the first line of its version output.
    """

    command: tuple[str, ...]
    version: str

    @property
    def identity(self) -> str:
        """Text of all that affects the compiled code, except the source."""
        return "\n".join([*self.command, self.version, *FLAGS, processor()])

    def build(self, source: str, target: Path) -> None:
        """Compile C++ into a shared library.

        Raises:
            CompilerError: it fails, or takes too long.
        """
        text = target.with_suffix(".cpp")
        try:
            text.write_text(source, encoding="utf-8")
            status, printed = _run([*self.command, *FLAGS, "-x", "c++", "-", "-o", str(target)], text)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise CompilerError(str(error)) from error
        if status != 0 or not target.is_file():
            message = next((line for line in printed.splitlines() if "error" in line.lower()), printed.strip())
            raise CompilerError(f"{' '.join(self.command)}: {message or f'status {status}'}"[:300])


def _run(command: Sequence[str], source: Path) -> tuple[int, str]:
    """Run the compiler and return its status and its output on stderr; it cannot outlive this process.

    It reads the source from its standard input; its temporary files go into the folder of the source and are removed with it.

    Raises:
        OSError: it cannot be run.
        subprocess.TimeoutExpired: it takes too long.
    """
    read_end, write_end = os.pipe()
    with open(read_end, "rb"), open(write_end, "wb") as alive, source.open("rb") as stream:
        guard = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", GUARD_PROGRAM, str(read_end), *command],
            stdin=stream,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            pass_fds=(read_end,),
            start_new_session=True,
            env={**os.environ, "TMPDIR": str(source.parent)},
            text=True,
            errors="replace",
        )
        with guard, alive:  # closing `alive` first ends a compiler that still runs
            printed = guard.communicate(timeout=COMPILE_TIMEOUT_S)[1]
    return guard.returncode, printed


def find_compiler() -> Compiler | None:
    """Return the compiler that ``CXX`` names, else the first of `CANDIDATES`; None if there is none."""
    return _found(os.environ.get("CXX", ""), os.environ.get("PATH", ""))


@cache
def _found(named: str, path: str) -> Compiler | None:
    try:
        own = tuple(shlex.split(named))
    except ValueError:  # an unmatched quotation mark
        return None
    for words in [own] if own else [(name,) for name in CANDIDATES]:
        program = shutil.which(words[0], path=path)
        if program is None:
            continue
        command = (program, *words[1:])
        try:
            answer = subprocess.run([*command, "--version"], capture_output=True, text=True, timeout=10.0, check=False)
        except (OSError, subprocess.TimeoutExpired):
            continue
        return Compiler(command, answer.stdout.split("\n", 1)[0].strip())
    return None


@cache
def processor() -> str:
    """Return a description of the processor that ``-march=native`` compiles for."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").split("\n\n", 1)[0].splitlines()
    except OSError:
        lines = []
    wanted = ("vendor_id", "cpu family", "model", "model name", "stepping", "flags", "Features", "CPU part")
    known = [line for line in lines if line.split(":")[0].strip() in wanted]
    return "\n".join([platform.system(), platform.machine(), platform.processor(), *known])
