"""Programs in the manner of postprocessors, compensated; the original and the output are executed by an interpreter of its own.

`corpus` holds the programs, written for these tests. Each states below how many block ends it has on known positions and where the last
feed ends, computed by hand for programs without tool centre point control and planes.
"""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np
import pytest

from tests.nc.corpus_machine import LENGTHS, OFFSETS, run_iso, run_plain
from tests.truth.machine import TruthMachine
from twin.compensation import Compensation, Compensator, Options
from twin.compensation.programs.check import check_program
from twin.compensation.programs.words import Setup
from twin.controls.offsets import OffsetTable, ToolTable
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import read_program

CORPUS = Path(__file__).parent / "corpus"
PROGRAMS = sorted(CORPUS.iterdir())
End = tuple[np.ndarray, bool, float]
SETUP = Setup(
    offsets=OffsetTable(Path("o.csv"), {name: dict(zip("XYZ", row, strict=True)) for name, row in OFFSETS.items()}),
    tools=ToolTable(Path("t.csv"), LENGTHS),
    harmless=("O9021", "O9100", "WARM_UP"),
    auxiliary_axes=("W",),
)
BETWEEN = 400
"""Most blocks of the output between two ends of the original that are compared."""
ROUNDING_UM = 1.2
LAST_FEED = {
    "haas_facing.nc": (250 + 40, 225 + 30, -390 + 131.5 + 12),
    "mill_begins_in_increments.nc": (250 - 20, 225 + 15, -390 + 80 + 50),
    "tnc_facing.h": (250 - 52.5, 225 - 10, -390 + 80 + 22),
    "fanuc_quill_and_macros.ptp": (250 + 45, 225 - 22.5, -390 + 131.5 + 12),
    "tnc_older_post.h": (250 - 30, 225 - 20, -390 + 131.5 + 8),
    "polar_holes_and_taps.ngc": (250 - 8, 225 + 12, -390 + 95.5 + 15),
    "fanuc_back_boring.nc": (250 + 12, 225 - 14, -390 + 80 + 20),
    "tnc_contour.h": (250 - 60, 225 - 45, -390 + 80 + 15),
}
CONTROLS = {
    "mazak": "Fanuc",
    "haas": "Fanuc",
    "fanuc": "Fanuc",
    "linuxcnc": "",  # no word that other controls do not have
    "mill": "Fanuc",
    "okuma": "Okuma",
    "sinumerik": "SINUMERIK",
    "tnc": "HEIDENHAIN",
    "twp": "LinuxCNC",
    "polar": "LinuxCNC",
}


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return Calibration.default(dmu50)


def compensated(path: Path, machine: Machine, errors: Calibration) -> Compensation:
    read, dialect = read_program(path)
    return Compensator(machine, errors, Options(setup=SETUP)).compensate(read, dialect)


@pytest.mark.sample(24)  # of 48
@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_the_output_leads_the_real_machine_where_the_program_means(
    dmu50: Machine, errors: Calibration, path: Path
) -> None:
    truth, meant = leads_where_meant(dmu50, errors, path)
    assert len(meant) > 5
    before, _ = truth.deviations(np.array([row[0] for row in meant]), np.array([row[0] for row in meant]))
    assert before.max() > 20.0
    if path.name in LAST_FEED:
        feeds = [place for place, cutting, _ in meant if cutting]
        assert feeds[-1][:3] == pytest.approx(LAST_FEED[path.name], abs=1e-9)


def leads_where_meant(machine: Machine, errors: Calibration, path: Path) -> tuple[TruthMachine, list[End]]:
    """Check that the output of a program reaches the ends of the original in order; return the machine and these ends."""
    run = run_plain if path.suffix == ".h" else run_iso
    result = compensated(path, machine, errors)
    meant, done = run(path.read_text()).ends, run(result.text).ends
    at = 0
    for position, cutting, length in meant:
        assert errors.path is not None
        truth = TruthMachine(errors.path, length)
        turned = 0.2 + 0.05 / max(
            np.sin(np.radians(abs(position[3]))), 0.01
        )  # near B = 0 a small tilt is a large turn of C
        near = np.array([place for place, _, _ in done[at : at + BETWEEN]])
        off_um, _ = truth.deviations(near, np.repeat(position[None], len(near), axis=0))
        reached = np.flatnonzero((off_um < ROUNDING_UM) & (np.abs(near[:, 3:] - position[3:]).max(axis=1) < turned))
        assert reached.size, f"{position} {cutting}: {off_um.min():.2f} µm"
        at += int(reached[0])
    assert at >= len(done) - 2
    return truth, meant


class Posted:
    """A program as a postprocessor could have written it: operations drawn at random."""

    def __init__(self, seed: str) -> None:
        self.rng = Random(seed)

    def near(self, size: float) -> str:
        """Return a number around zero as written."""
        return f"{self.rng.uniform(-size, size):.{self.rng.randrange(1, 4)}f}"

    def sinumerik(self) -> str:
        """Return a program with frames, tool centre point control, tool vectors, swivelled planes and cycles."""
        rng, near = self.rng, self.near
        lines = ["N1 G17 G710 G90 G94 G40", 'N2 T="MILL_D10"', "N3 M6", rng.choice(["G54", "G505"]) + " D1", "F900"]
        for _ in range(rng.randrange(2, 5)):
            lines += ["SUPA G0 Z=-1 D0", f"G0 B{rng.uniform(0, 70):.3f} C{near(150)}", "D1"]
            kind = rng.choice(["axis", "frame", "tcp", "turned tcp", "vector", "swivel"])
            frame = [f"TRANS X{near(8)} Y{near(8)} Z{near(3)}"] if rng.random() < 0.6 else []
            frame += [f"AROT {rng.choice('XYZ')}{near(60)}" for _ in range(rng.randrange(1, 4))]
            frame += [f"ATRANS X{near(4)} Z{near(2)}"] if rng.random() < 0.4 else []
            if kind == "swivel":
                lines.append(
                    f'CYCLE800(1,"DMU",0,57,{near(9)},{near(9)},{near(4)},{near(30)},{near(30)},{near(30)},0,0,0,1)'
                )
            lines += ["TRAORI"] if kind in ("tcp", "turned tcp", "vector") else []
            lines += frame if kind in ("frame", "turned tcp") else []
            lines.append(f"G0 X{near(30)} Y{near(30)} Z{rng.uniform(30, 60):.2f}")
            for _ in range(rng.randrange(2, 6)):
                lines.append(f"G1 X{near(30)} Y{near(30)} Z{rng.uniform(2, 20):.3f}")
                if kind in ("tcp", "turned tcp") and rng.random() < 0.6:
                    lines[-1] += f" B={rng.uniform(5, 60):.3f} C={near(90)}"
                elif kind == "vector":
                    lines[-1] += f" A3={near(0.4)} B3={near(0.4)} C3=0.{rng.randrange(6, 10)}"
            if kind in ("frame", "axis"):
                lines += self.about_poles()
            if kind in ("turned tcp", "frame", "axis") and rng.random() < 0.5:
                lines += [
                    "G0 Z40",
                    f"MCALL CYCLE81(30,2,3,-{rng.uniform(1, 8):.2f})",
                    *(f"X{near(20)} Y{near(20)}" for _ in "ab"),
                    "MCALL",
                ]
            lines += ["TRAFOOF"] if "tcp" in kind or kind == "vector" else ["CYCLE800()"] if kind == "swivel" else []
            lines.append("TRANS")
        return "\n".join([*lines, "SUPA G0 Z=-1 D0", "M30", ""])

    def about_poles(self) -> list[str]:
        """Return blocks of SINUMERIK by poles, angles and directions, some with rounded corners."""
        rng, near = self.rng, self.near
        lines = [f"G111 X{near(9)} Y{near(9)}"]
        for _ in range(rng.randrange(5)):
            kind = rng.choice(["AP", "AR", "ANG", "G112"])
            corner = rng.choice(["", "", " RND=0.5", " CHF=0.4"])
            if kind == "AP":
                lines.append(f"G1 AP={rng.uniform(-170, 170):.2f} RP={rng.uniform(5, 20):.3f}{corner}")
            elif kind == "AR":
                lines.append(
                    f"G{rng.choice('23')} I{rng.uniform(2, 6):.2f} J{near(4)} AR={rng.uniform(20, 150):.1f}{corner}"
                )
            elif kind == "ANG":
                lines.append(f"G1 ANG={rng.uniform(-30, 30):.2f} X{rng.uniform(-20, 20):.3f}{corner}")
            else:
                lines.append(f"G112 X{near(3)} Y{near(3)}")
        return [*lines, f"G1 X{near(10)} Y{near(10)}"]

    def holes(self) -> list[str]:
        """Return blocks of plain language with corners that the control shapes, and a cycle called at other places."""
        rng, near = self.rng, self.near
        lines = [f"L X{near(20)} Y{near(20)} F600", f"RND R{rng.uniform(0.2, 1):.2f}", f"L X{near(20)} Y{near(20)}"]
        surface, second = rng.uniform(5, 12), rng.uniform(5, 25)
        lines += ["CYCL DEF 200 DRILLING ~", "Q200=2 ~", "Q201=-5 ~", "Q206=150 ~", "Q202=5 ~", "Q210=0 ~"]
        lines += [f"Q203={surface:+.2f} ~", f"Q204={second:.2f} ~", "Q211=0", "L Z+50 FMAX"]
        if rng.random() < 0.5:
            return [
                *lines,
                f"CYCL CALL POS X{rng.uniform(1, 20):+.2f} Y{rng.uniform(-20, -1):+.2f} Z{rng.uniform(-2, -1):+.2f} FMAX",
            ]
        first = f"X{rng.uniform(1, 9):+.2f} Y{rng.uniform(1, 9):+.2f}"
        lines.insert(3, f"PATTERN DEF ROW1 ({first} D+4.5 NUM3 ROT+{rng.uniform(0, 90):.1f} Z+0)")
        return [*lines, "CYCL CALL PAT FMAX"]

    def plain(self) -> str:
        """Return a program in plain language with shifts, planes, and tool centre point control in and out of planes."""
        rng, near = self.rng, self.near
        lines = ["BEGIN PGM A MM", f"CYCL DEF 247 Q339=+{rng.randrange(1, 3)}", "TOOL CALL 2 Z S5000"]
        for _ in range(rng.randrange(2, 5)):
            kind = rng.choice(["axis", "tcp", "plane", "vector plane", "inclined", "cycle 19"])
            lines += ["L M140 MB MAX", f"L B{rng.uniform(0, 70):+.3f} C{near(150)} R0 FMAX", "CYCL DEF 7.0 DATUM SHIFT"]
            lines += [f"CYCL DEF 7.{i} {axis}{near(8)}" for i, axis in enumerate("XYZ", 1)]
            way = rng.choice(["TURN FMAX", "STAY"])
            angles = rng.uniform(5, 30), rng.uniform(-30, 30), rng.uniform(-40, 40)
            if kind == "plane":
                lines.append("PLANE SPATIAL SPA{:+.3f} SPB{:+.3f} SPC{:+.3f} ".format(*angles) + way)
            elif kind in ("vector plane", "inclined"):
                lines.append(f"PLANE VECTOR BX0.9 BY{near(0.3)} BZ{near(0.2)} NX{near(0.3)} NY{near(0.3)} NZ0.9 {way}")
            elif kind == "cycle 19":
                lines.append("CYCL DEF 19.1 A{:+.3f} B{:+.3f} C{:+.3f}".format(*angles))
            if kind == "cycle 19" or (way == "STAY" and kind not in ("axis", "tcp")):
                lines.append("L B+Q121 C+Q122 R0 FMAX")
            lines += ["L M128"] if kind in ("tcp", "inclined") else []
            lines.append(f"L X{near(30)} Y{near(30)} Z{rng.uniform(40, 60):+.2f} R0 FMAX")
            for _ in range(rng.randrange(2, 6)):
                lines.append(f"L X{near(30)} Y{near(30)} Z{rng.uniform(2, 20):+.3f}")
                lines[-1] += f" B{rng.uniform(5, 60):+.3f} C{near(90)}" if kind in ("tcp", "inclined") else ""
                lines[-1] += rng.choice(["", " F700"])
            lines += ["M129"] if kind in ("tcp", "inclined") else []
            if kind in ("axis", "plane", "vector plane", "cycle 19"):
                lines += self.holes()
            lines += ["L Z-1 R0 FMAX M91", "CYCL DEF 19.1" if kind == "cycle 19" else "PLANE RESET STAY"]
        return "\n".join([*lines, "M30", "END PGM A MM", ""])


@pytest.mark.sample(10)
@pytest.mark.parametrize("seed", range(40))
@pytest.mark.parametrize("language", ["sinumerik", "plain"])
def test_random_programs_of_posts(
    dmu50: Machine, errors: Calibration, tmp_path: Path, language: str, seed: int
) -> None:
    path = tmp_path / ("a.h" if language == "plain" else "a.mpf")
    path.write_text(getattr(Posted(f"{language} {seed}"), language)())
    assert leads_where_meant(dmu50, errors, path)[1], path.read_text()


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_without_errors_every_byte_stays(dmu50: Machine, path: Path) -> None:
    result = compensated(path, dmu50, Calibration.zero(dmu50))
    read, _ = read_program(path)
    assert result.text == read.text and (read.origins or result.text.encode() == path.read_bytes())


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_check_says_that_it_will_go(dmu50: Machine, path: Path) -> None:
    check = check_program(path, dmu50, options=Options(setup=SETUP))
    assert check.error is None and not check.lacks
    assert not any(one.beyond for one in check.travel.values())
    wanted = "in part" if path.name == "mill_begins_in_increments.nc" else "ready"  # a feed before the first position
    assert check.verdict == wanted and check.control == CONTROLS[path.name.split("_")[0]]
