"""Reading one five-axis program of `tests.benchmarks.programs`: text in memory to positions in memory.

`twin` interprets: modal state, units, every word of the language known or refused, one position of all axes for each block. The peers
split lines into words, without modal state; `pygcode` also groups the words by G-code and checks modal groups. The positions of all
blocks are compared.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from tests.benchmarks import programs
from tests.benchmarks.peers.record import Measured, Peer, Section, section
from tests.benchmarks.timing import timed
from twin.compensation import Options
from twin.compensation.programs.parts import PartReader, ProgramFile
from twin.compensation.programs.prepared import PreparedMachine
from twin.compensation.programs.words import axis_words
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import dialect_for
from twin.nc.blocks import Move

OURS = 200_000
"""Blocks read by `twin`: compiled code from some 50,000 on, if there is a compiler."""
TOKENS = 20_000
"""Blocks read by gcodeparser."""
WORDS = 2_000
"""Blocks read by pygcode."""
REPEATS = 5
AXES = "XYZBC"


@cache
def _text(blocks: int) -> str:
    """Return a program."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "p.nc"
        programs.program(path, blocks)
        return path.read_text()


def _expected(blocks: int) -> np.ndarray:
    """Return (blocks, axes) the values of the axis words, by splitting the text."""
    lines = (line.split() for line in _text(blocks).splitlines() if line.startswith("G1 X"))
    return np.array([[float(word[1:]) for word in words[1:]] for words in lines])


def _measured(read: Callable[[], object], found: np.ndarray) -> Measured:
    n = len(found)
    worst = float(np.abs(found - _expected(n)).max())
    result = f"positions differ from the text by up to {worst:.0e} mm or °" if worst else "all positions as in the text"
    return Measured(timed(read, REPEATS).each(n), n, result)


def by_twin(machine: Machine) -> Measured:
    """Measure reading in memory: the moves of `Dialect.moves`, an object for each."""
    data = _text(OURS).encode()
    dialect = dialect_for(Path("p.nc"), data)
    axes = axis_words(machine)

    def read() -> Sequence[Move]:
        return dialect.moves(dialect.read(data, "p.nc"), axes, tcp=False).moves

    return _measured(read, np.array([move.position for move in read()]))


def by_parts(machine: Machine) -> Measured:
    """Measure `PartReader`: arrays of moves and of their motions, from a file of any length, one part in memory at a time."""
    prepared = PreparedMachine(machine, Calibration.zero(machine), Options(tool_length_mm=100.0))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "p.nc"
        path.write_text(_text(OURS))

        def read() -> list[np.ndarray]:
            reader = PartReader(prepared, ProgramFile(path, dialect_for(path)))
            found = [part.moves.position for part in reader.parts()]
            if reader.failed is not None:
                raise reader.failed
            return found

        return _measured(read, np.concatenate(read()))


def by_gcodeparser() -> Measured:
    """Measure gcodeparser."""
    from gcodeparser import parse_gcode_lines

    text = _text(TOKENS)
    lines = [line for line in parse_gcode_lines(text) if line.command == ("G", 1) and "X" in line.params]
    found = np.array([[line.params[name] for name in AXES] for line in lines], dtype=float)
    return _measured(lambda: list(parse_gcode_lines(text)), found)


def by_pygcode() -> Measured:
    """Measure pygcode."""
    from pygcode import Line

    lines = _text(WORDS).splitlines()
    rows = []
    for line in map(Line, lines):
        words = {word.letter: word.value for word in line.block.words}
        if "X" in words:
            rows.append([float(words[name]) for name in AXES])
    return _measured(lambda: [Line(line) for line in lines], np.array(rows))


def sections(machine: Machine) -> tuple[Section, ...]:
    """Return the comparison."""
    return (
        section(
            "Reading a five-axis program (points are blocks)",
            "`Dialect.read` and `Dialect.moves`, which interpret the program in memory, an object for each move",
            by_twin(machine),
            [
                Peer(
                    ("twin",),
                    "`PartReader`, the reader of `twin compensate`: from a file, interpreted to arrays",
                    lambda: by_parts(machine),
                ),
                Peer(("gcodeparser",), "splits lines into words; no modal state", by_gcodeparser),
                Peer(
                    ("pygcode",),
                    "splits lines into words, grouped by G-code and checked; modal state not applied",
                    by_pygcode,
                ),
            ],
        ),
    )
