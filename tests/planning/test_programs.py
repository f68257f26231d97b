"""Measuring programs, run by small interpreters on ideal spheres: every contact is found, and no other move comes near.

The kinematics are those of `tests.truth.reference`, which shares no code with `twin`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import FrozenInstanceError
from pathlib import Path

import numpy as np
import pytest

from tests.truth.reference import dmu50_pose
from twin import cli
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.planning import SequencePlan, measuring_sequence
from twin.planning.programs.controls import PROGRAMS, ProgramFormat, format_of, write_program
from twin.planning.programs.steps import program_steps
from twin.planning.sequences.specification import InstrumentSizes

LENGTH, SPHERE, BALL, CLEARANCE = 120.0, 25.0, 6.0, 10.0
PLACE = np.array([150.0, 0.0, 60.0])
STEM, STYLUS_LENGTH, SAMPLES_MM = 7.5, 50.0, 1.5
NAMES = "XYZBC"
Motion = tuple[str, np.ndarray]
"""``move`` or ``probe`` with the position of all axes, NaN for one that has not moved yet."""


@pytest.fixture(scope="module")
def plan() -> SequencePlan:
    sizes = InstrumentSizes(LENGTH, SPHERE, BALL, CLEARANCE)
    return measuring_sequence(Machine.load("dmu50"), "probe", minutes=20.0, sizes=sizes)


def linuxcnc(text: str) -> Iterator[Motion]:
    """Interpret G0, G1, G38.2 with modal words; everything else must be known."""
    at, known = np.full(5, np.nan), {"G21", "G90", "G94", "G40", "G49", "G80", "G17", "G59.3", "G92.1", "M2"}
    # The offset and the tool length cancel.
    assert text.index("\nG10 L2 P9 X0 Y0 Z-120 B0 C0 R0\nG59.3\n") < text.index("\nG43.1 Z120\n") < text.index("G38.2")
    for line in text.splitlines():
        assert line.isascii() and len(line) <= 80
        code = re.sub(r"\([^()]*\)", "", line).split()
        assert "(" not in "".join(code)
        if not code or code[0] in ("G10", "G43.1") or set(code) <= known:
            continue
        target = at.copy()
        for word in code[1:]:
            if word[0] != "F":
                target[NAMES.index(word[0])] = float(word[1:])
        assert code[0] in ("G0", "G1", "G38.2")
        yield ("probe" if code[0] == "G38.2" else "move"), target
        if code[0] != "G38.2":
            at = target


def heidenhain(text: str) -> Iterator[Motion]:
    at, vector = np.full(5, np.nan), np.zeros(3)
    for number, line in enumerate(text.split("\r\n")[:-1]):
        block, _, code = line.partition(" ")
        assert int(block) == number and line.isascii() and len(line) <= 120
        if code.startswith("L ") and code not in ("L M30", "L M127"):
            assert code.endswith("M91")
            for name, value in re.findall(r"([XYZBC])([+-][\d.]+)", code):
                at[NAMES.index(name)] = float(value)
            yield "move", at.copy()
        elif code.startswith("TCH PROBE 4.2"):
            vector = np.array([float(v) for v in re.findall(r"I[XYZ]([+-][\d.]+)", code)])
            assert np.linalg.norm(vector) == pytest.approx(1.0, abs=1e-5)
        elif code.startswith("TCH PROBE 4.3"):
            target = at.copy()
            target[:3] += vector * float(re.findall(r"DIST\+([\d.]+)", code)[0])
            yield "probe", target


def siemens(text: str) -> Iterator[Motion]:
    at = np.full(5, np.nan)
    for line in text.splitlines():
        code = line.partition(";")[0] if line.startswith(";") else line
        words = re.findall(r"(?<![\w\[])([XYZBC])=(-?[\d.]+)", code)
        if not words:
            continue
        assert "SUPA" in code
        target = at.copy()
        for name, value in words:
            target[NAMES.index(name)] = float(value)
        yield ("probe" if code.startswith("MEAS=1 G1") else "move"), target
        if "MEAS" not in code:
            at = target


READERS = {"linuxcnc": linuxcnc, "heidenhain": heidenhain, "siemens": siemens}


def tip(q: np.ndarray) -> np.ndarray:
    """Return the tip and the direction from it to the spindle in the work frame, (2, 3)."""
    pose = dmu50_pose([*q[:3], *np.radians(q[3:])], {}, LENGTH)  # type: ignore[arg-type]
    return np.array([pose[:3, 3], pose[:3, 2]])


def between(a: np.ndarray, b: np.ndarray) -> list[np.ndarray]:
    count = int(np.ceil(max(np.abs(b - a)[:3].max() / SAMPLES_MM, np.abs(b - a)[3:].max() / 1.0))) + 1
    return [a + part * (b - a) for part in np.linspace(0.0, 1.0, count)]


def distance_to_stem(q: np.ndarray) -> float:
    """Return the smallest distance of the stylus' axis from the axis of the sphere's stem, mm."""
    point, up = tip(q)
    stylus = point + np.linspace(0.0, STYLUS_LENGTH, 26)[:, None] * up
    stem = np.array([PLACE[0], PLACE[1], 0.0]) + np.linspace(0.0, PLACE[2] - 0.5 * SPHERE, 25)[:, None] * [0, 0, 1]
    return float(np.linalg.norm(stylus[:, None] - stem[None], axis=2).min())


def run(motions: Iterator[Motion], sphere: np.ndarray) -> list[np.ndarray]:
    """Run a program on an ideal sphere and return the positions of the contacts; no move may come near it."""
    contact, here, found = (SPHERE + BALL) / 2.0, np.full(5, np.nan), []
    low, high = np.array([0.0, 0.0, -400.0, 0.0, -np.inf]), np.array([500.0, 450.0, 0.0, 180.0, np.inf])
    error = float(np.linalg.norm(sphere - PLACE))
    for kind, end in motions:
        known = np.isfinite(end)
        assert np.all(end[known] >= low[known]) and np.all(end[known] <= high[known])
        if not np.isfinite(here).all():
            here = end
            continue
        way = between(here, end)
        away = np.array([np.linalg.norm(tip(q)[0] - sphere) for q in way])
        assert min(distance_to_stem(q) for q in way[:: max(1, len(way) // 12)]) > (STEM + BALL) / 2.0 + 2.0
        if kind == "move":
            assert away.min() > contact + CLEARANCE - error - 0.01
            here = end
            continue
        assert np.array_equal(here[3:], end[3:])
        assert away[0] > contact > away.min(), "no contact within the search"
        first = int(np.argmax(away <= contact))
        part = (away[first - 1] - contact) / (away[first - 1] - away[first])
        found.append(way[first - 1] + part * (way[first] - way[first - 1]))
    return found


@pytest.mark.parametrize("form", PROGRAMS, ids=lambda one: one.name)
def test_a_specification_is_complete_and_cannot_change(form: ProgramFormat) -> None:
    assert form.title and form.source and form.unverified and form.suffixes
    assert all(format_of(f"a{suffix.upper()}") is form for suffix in form.suffixes)
    with pytest.raises(FrozenInstanceError):
        form.name = "another"  # type: ignore[misc]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("form", "off_mm"), [(form, (2.0, -1.5, 2.0)) for form in PROGRAMS], ids=[form.name for form in PROGRAMS]
)
def test_every_contact_is_found(
    plan: SequencePlan, tmp_path: Path, form: ProgramFormat, off_mm: tuple[float, float, float]
) -> None:
    """The five contacts of each pose give the sphere's centre, also of a sphere that is not quite at its place."""
    path = tmp_path / f"sphere{form.suffixes[0]}"
    steps = program_steps(plan)
    write_program(steps, path)
    assert not steps.skipped and steps.poses == len(plan.table)
    text = path.read_bytes().decode("ascii")
    sphere = PLACE + np.array(off_mm)
    contacts = np.array(run(READERS[form.name](text), sphere)).reshape(-1, 5, 5)
    assert len(contacts) == steps.poses
    for pose, position in zip(contacts, plan.table.positions, strict=True):
        assert np.allclose(pose[:, 3:], position[3:])
        # The sphere of known radius through five contacts, in axis coordinates, has its centre where the tip is at the sphere's.
        centre = pose[:, :3].mean(axis=0)
        for _ in range(20):
            away = centre - pose[:, :3]
            size = np.linalg.norm(away, axis=1)
            centre = centre - np.linalg.lstsq(away / size[:, None], size - (SPHERE + BALL) / 2.0, rcond=None)[0]
        assert np.linalg.norm(tip(np.array([*centre, *position[3:]]))[0] - sphere) < 0.01


@pytest.mark.slow
def test_the_log_becomes_a_measurement_table(plan: SequencePlan, tmp_path: Path) -> None:
    """Each control's log of the contacts, read by `twin convert`, gives the positions of the plan."""
    steps, machine = program_steps(plan), plan.machine
    for form in PROGRAMS:
        path = tmp_path / f"log{form.suffixes[0]}"
        write_program(steps, path)
        text = path.read_bytes().decode("ascii")
        contacts = np.array(run(READERS[form.name](text), PLACE))
        if form.name == "linuxcnc":
            entries = re.findall(r"\(LOG,(.*)\)", text)
            assert set(entries[1:]) == {"#5061,#5062,#5063,#5065,#5066,sphere"} and len(entries) == len(contacts) + 1
            log = [entries[0]] + [",".join(f"{v:.6f}" for v in q) + ",sphere" for q in contacts]
        elif form.name == "heidenhain":
            mask, numbers = re.findall(r'"(CONTACT [^"]*)",([Q\d,]+);', text)[0]
            assert numbers == "Q201,Q202,Q203,Q205,Q206,Q220" and "TCH PROBE 4.1 Q201" in text
            log = [mask.replace("l", "") % (*q, 1) for q in contacts]
        else:
            log = re.findall(r'"(contact_x_mm[^"]*)"', text) + [
                ",".join(f"{v:.5f}" for v in q) + ",sphere" for q in contacts
            ]
        file = tmp_path / f"log_{form.name}.{'txt' if form.name == 'heidenhain' else 'csv'}"
        file.write_text("\n".join(log) + "\n")
        words = " ".join(re.sub(r"(?m)^\d+ ;|^;|[()]", " ", text).split())
        command = re.findall(r"twin convert \S+ (.*?) -o measured.csv", words)[0]
        table = tmp_path / f"{form.name}.csv"
        with pytest.raises(SystemExit) as stopped:
            cli.main(["convert", str(file), *command.split(), "-o", str(table)])
        assert not stopped.value.code
        data = Measurements.load(table, machine)
        assert np.allclose(data.positions, plan.table.positions, atol=0.01) and set(data.instrument) == {"probe"}


def test_the_header_says_what_it_is(plan: SequencePlan, tmp_path: Path) -> None:
    for form in PROGRAMS:
        path = tmp_path / f"a{form.suffixes[0]}"
        write_program(program_steps(plan), path)
        lines = path.read_text().split("pose 1")[0].splitlines()
        head = " ".join(re.sub(r"^\d+ ;|^;|[()]", " ", line).strip() for line in lines)
        for word in ("NOT RUN ON A MACHINE", "DMU 50 eVolution", "120 mm", "NOT checked"):
            assert word in head, (form.name, word)


def test_a_log_is_opened_and_closed(plan: SequencePlan, tmp_path: Path) -> None:
    path = tmp_path / "my sphere 2.ngc"
    write_program(program_steps(plan), path)
    text = path.read_text()
    assert text.index("(LOGOPEN,MY_SPHERE_2_LOG.csv)") < text.index("G38.2") < text.index("(LOGCLOSE)")
    write_program(program_steps(plan), tmp_path / "2.h")
    assert "BEGIN PGM T_2 MM" in (tmp_path / "2.h").read_text()


def test_a_program_is_refused_for_other_instruments_and_suffixes() -> None:
    bar = measuring_sequence(Machine.load("dmu50"), "ball-bar")
    with pytest.raises(InputError, match="touch probe"):
        program_steps(bar)
    with pytest.raises(InputError, match="suffix"):
        format_of("a.txt")


def test_the_command_writes_plan_and_program(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan, program, report = tmp_path / "p.csv", tmp_path / "p.mpf", tmp_path / "p.json"
    words = f"plan --instrument probe --sequence turns -o {plan} --program {program} --json {report} --kit dmu50"
    with pytest.raises(SystemExit) as stopped:
        cli.main([*words.split(), "--sphere-diameter", "20", "--ball-diameter", "4", "--clearance", "8"])
    assert not stopped.value.code
    said = json.loads(report.read_text())
    assert said["program"]["control"] == "Siemens SINUMERIK" and said["not_probed"] == []
    assert "NOT RUN ON A MACHINE" in capsys.readouterr().out
    assert "ILLUSTRATIVE" in program.read_text() and program.read_text().count("MEAS=1") == 5 * said["points"]
