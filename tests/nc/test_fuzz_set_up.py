"""Tables of offsets and tools, subprograms, cycles and planes with random damage: they are read, or refused with an `InputError`."""

from __future__ import annotations

import random
from contextlib import suppress
from pathlib import Path

import pytest

from tests.compensation.test_tilted_planes import PLANES
from tests.nc.test_calls import CASES
from tests.nc.test_cycles import CYCLES, START
from tests.nc.test_tables import OFFSETS, PRESETS, TOOLS
from twin._common.errors import InputError
from twin.controls.offsets import load_offsets, load_tools
from twin.nc import read_program
from twin.nc.blocks import AxisWords

CHARACTERS = '0123456789.,-+=[]()#<>;"GMXYZPLRQ \n\t%$/Ä\x00e'
AXES = AxisWords(("X", "Y", "Z"), ("B", "C"), dict.fromkeys("XYZBC", 0.001), offsets_known=True, tools_known=True)
PROGRAMS = [
    *((".nc", START + text) for text, _, _ in CYCLES.values()),
    *((".h" if text.startswith("BEGIN") else ".mpf", text) for text, _, _ in PLANES.values()),
    *((Path(name).suffix, text) for files, _ in CASES.values() for name, text in list(files.items())[:1]),
]


def damaged(text: str, rng: random.Random) -> str:
    letters = list(text)
    for _ in range(rng.randint(1, 4)):
        at, what = rng.randrange(max(1, len(letters))), rng.random()
        if what < 0.4 and letters:
            letters[at] = rng.choice(CHARACTERS)
        elif what < 0.7:
            del letters[at : at + rng.randint(1, 8)]
        else:
            letters.insert(at, rng.choice(CHARACTERS))
    return "".join(letters)


@pytest.mark.parametrize("count", [250, pytest.param(6000, marks=pytest.mark.slow)])
def test_damaged_tables(tmp_path: Path, count: int) -> None:
    rng = random.Random(count)
    texts = [*OFFSETS.values(), *TOOLS.values(), PRESETS]
    for _ in range(count):
        path = tmp_path / "table.csv"
        path.write_text(damaged(rng.choice(texts), rng), encoding="utf-8")
        for load in (load_offsets, load_tools):
            with suppress(InputError):
                load(path)


@pytest.mark.parametrize("count", [250, pytest.param(12000, marks=pytest.mark.slow)])
def test_damaged_programs(tmp_path: Path, count: int) -> None:
    rng = random.Random(count)
    for _ in range(count):
        suffix, text = rng.choice(PROGRAMS)
        path = tmp_path / f"program{suffix}"
        path.write_text(damaged(text, rng), encoding="utf-8")
        with suppress(InputError):
            program, dialect = read_program(path)
            dialect.moves(program, AXES, tcp=rng.random() < 0.2)
