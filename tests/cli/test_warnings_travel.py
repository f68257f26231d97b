"""Warnings about the source of numbers appear in every file made from a calibration or from readings."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from twin import cli
from twin._common.errors import InputError
from twin._common.provenance import (
    ILLUSTRATIVE,
    NOT_IDENTIFIABLE,
    PARTLY_UNKNOWN_UNCERTAINTY,
    SIMULATED,
    SYSTEMATIC_RESIDUALS,
    UNKNOWN_UNCERTAINTY,
    UNSETTLED_ESTIMATE,
    SourceWarning,
    merge_warnings,
)
from twin.identification import identify
from twin.identification.axis_layout import AxisLayout, load_readings, simulate_run
from twin.identification.axis_run import axis_curves, error_motions
from twin.identification.thesis import identify_as_thesis
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.nc import DIALECTS
from twin.nc.heidenhain.dialect import Heidenhain
from twin.nc.iso.dialect import Iso
from twin.samples import thesis_plan

COVARIANCE: Final = ", covariance: [[1.0, 0], [0, 2.0]]"
NOT_KNOWN: Final = NOT_IDENTIFIABLE.about(["E_XY"])
KINDS: Final[dict[str, tuple[str, str, str, tuple[SourceWarning, ...]]]] = {
    # name: entry of the file, entry of the curve, covariance of the curve, warnings
    "nothing": ("", "", COVARIANCE, ()),
    "illustrative": ("", ", illustrative: true", COVARIANCE, (ILLUSTRATIVE,)),
    "simulated": ("simulated: true", "", COVARIANCE, (SIMULATED,)),
    "unknown": ("", "", "", (UNKNOWN_UNCERTAINTY,)),
    "unsettled": ("settled: false", "", COVARIANCE, (UNSETTLED_ESTIMATE,)),
    "not identified": ("not_identifiable: [{name: E_XY, why: Y did not move}]", "", COVARIANCE, (NOT_KNOWN,)),
    "misfit": ("misfit: {verdict: systematic}", "", COVARIANCE, (SYSTEMATIC_RESIDUALS,)),
    "all": (
        "simulated: true\nmisfit: {verdict: systematic}\nnot_identifiable: [{name: E_XY, why: Y did not move}]",
        ", illustrative: true",
        "",
        (ILLUSTRATIVE, SIMULATED, NOT_KNOWN, SYSTEMATIC_RESIDUALS, UNKNOWN_UNCERTAINTY),
    ),
}
EVERY: Final = (
    ILLUSTRATIVE,
    SIMULATED,
    UNSETTLED_ESTIMATE,
    NOT_KNOWN,
    SYSTEMATIC_RESIDUALS,
    UNKNOWN_UNCERTAINTY,
)
PROGRAMS: Final = {
    "p.nc": "%\nO1234 (part)\nG21 G90 G0 X100 Y100 Z-100\nG1 X200 F500\nM30\n%\n",
    "p.mpf": "%_N_PART_MPF\n;$PATH=/_N_WKS_DIR\nG90 G0 X100 Y100 Z-100\nG1 X200 F500\nM30\n",
    "p.h": "0 BEGIN PGM P MM\n1 L X+100 Y+100 Z-100 R0 FMAX\n2 L X+200 R0 F500\n3 END PGM P MM\n",
    "p.cls": "PARTNO/P\nRAPID\nGOTO/-100,-50,60\nFEDRAT/500,MMPM\nGOTO/100,-50,60\nFINI\n",
}
FORMATS: Final = ("siemens", "heidenhain", "linuxcnc", "isg")


def calibration_text(kind: str) -> str:
    entry, curve, covariance, _ = KINDS[kind]
    return (
        f"schema: twin.calibration/1\nmachine: DMU 50 eVolution\nsource: by hand\n{entry}\ncurves:\n"
        f"  E_XX: {{unit: um, domain: [0, 500], basis: power, coefficients: [20.0, 30.0]{covariance}{curve}}}\n"
        f"  E_YX: {{unit: um, domain: [0, 500], basis: power, coefficients: [1.0, 30.0]{covariance}}}\n"
    )


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as caught:
        cli.main([str(one) for one in arguments])
    return int(caught.value.code or 0)


def words(text: str) -> str:
    """Return a text without line breaks and comment signs, since a comment may span two lines."""
    kept = [line.lstrip("0123456789 ;#$/(").rstrip(")\r\n") for line in text.splitlines()]
    return " ".join(" ".join(kept).split()).upper().replace("&NBSP;", " ").replace("\u00a0", " ")


def said(text: str) -> set[str]:
    """Return the names of the warnings in a text."""
    found = words(text)
    return {one.name for one in EVERY if one.title in found}


def named(path: Path) -> set[str]:
    """Return the names of the warnings in a JSON file."""

    def lists(data: Any) -> Iterator[list[dict[str, str]]]:
        if isinstance(data, dict):
            for key, value in data.items():
                if key == "warnings":
                    yield value
                yield from lists(value)

    (first, *others) = lists(json.loads(path.read_text()))
    assert all(other == first for other in others)
    assert all(set(one) == {"name", "text"} for one in first)
    return {one["name"] for one in first}


Files = dict[str, set[str]]
KINEMATICS: Final = ("kinematics.json", "kinchain.mpf", "README.txt")
"""Files made in the datum mean lines."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Files]:
    """Return a function that gives, for a kind of warning, the warnings in every file made from such a calibration."""
    known: dict[str, Files] = {}

    def of(kind: str) -> Files:
        if kind not in known:
            folder = tmp_path_factory.mktemp(kind)
            (folder / "mine.yaml").write_text(calibration_text(kind))
            known[kind] = files(folder, cut=kind != "unsettled", drawn=kind not in ("unknown", "all"))
        return known[kind]

    return of


def files(folder: Path, *, cut: bool, drawn: bool) -> Files:
    """Make every kind of file; ``cut``: also programs and tables; ``drawn``: also draws from the covariance."""
    mine, out = folder / "mine.yaml", folder / "out.json"
    given = ("-c", mine, "--json", out)
    found: Files = {}
    for name, text in PROGRAMS.items():
        (folder / name).write_text(text)
    if cut:
        for name in (*PROGRAMS, "p.cls as p.nc", "p.cls as p.h"):
            program, _, suffix = name.partition(" as p")
            target = folder / f"out{suffix or Path(program).suffix}"
            assert run("compensate", folder / program, "-o", target, "--report", folder / "r.txt", *given) == 0
            found[f"program {name}"] = said(target.read_text())
            found["report.txt"], found["compensate.json"] = said((folder / "r.txt").read_text()), named(out)
        assert run("path", folder / "p.h", "-o", folder / "path.h", *given) == 0
        found["path.h"], found["path.json"] = said((folder / "path.h").read_text()), named(out)
        many = folder / "many"
        many.mkdir()
        assert run("compensate", folder / "p.nc", folder / "p.h", "-o", many, *given) == 0
        found |= {f"many {path.name}": said(path.read_text()) for path in many.iterdir() if path.suffix != ".json"}
        for kind in FORMATS:
            tables = folder / kind
            assert run("control", "--to", kind, "-o", tables, *given) == 0
            found[f"{kind}.json"] = named(out)
            written = Calibration.load(tables / "calibration.yaml", Machine.load("dmu50"))
            found[f"{kind} calibration.yaml"] = {one.name for one in written.warnings}
            rest = [path for path in tables.iterdir() if path.name != "calibration.yaml"]
            found |= {f"{kind} {path.name}": said(path.read_text()) for path in rest}
        held = folder / "kinematics"
        assert run("control", "--kinematics", "siemens-chain", "-o", held, *given) == 0
        found["kinematics.json"] = named(out)
        for path in (held / "kinchain.mpf", held / "README.txt"):
            found[path.name] = said(path.read_text())
        assert run("control", "--read", folder / "siemens" / "cec.mpf", "--format", "siemens", *given) == 0
        found["control --read"] = named(out)
    assert run("report", "-o", folder / "report.html", *given) == 0
    found["report.html"], found["report.json"] = said((folder / "report.html").read_text()), named(out)
    assert run("scene", folder / "p.nc", "-o", folder / "scene.html", *given) == 0
    found["scene.html"], found["scene.json"] = said((folder / "scene.html").read_text()), named(out)
    run("compare", mine, mine, "--json", out)
    found["compare.json"] = named(out)
    if drawn:
        assert run("volume", "--trials", 2000, "--poses", 5, "--workers", 1, *given) == 0
        found["volume.json"] = named(out)
    assert run("info", *given) == 0
    found["info.json"] = named(out)
    return found


ONE_ALONE: Final = ("nothing", "illustrative", "simulated", "unknown", "not identified", "misfit")
"""Slow kinds; those after the first are combined in ``all``."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.slow) if kind in ONE_ALONE else kind for kind in KINDS]
)
def test_every_file_has_the_warnings_of_its_calibration(kind: str, made: Callable[[str], Files]) -> None:
    wanted = {one.name for one in KINDS[kind][3]}
    found = made(kind)
    assert len(found) >= (6 if kind == "unsettled" else 35)
    # In mean lines there are errors that the calibration does not state, and whose uncertainty it therefore does not give.
    unstated = {name: wanted | {UNKNOWN_UNCERTAINTY.name} for name in KINEMATICS}
    assert {name: one for name, one in found.items() if one != unstated.get(name, wanted)} == {}


def test_unconverged_estimate_gives_no_program_and_no_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.yaml").write_text(calibration_text("unsettled"))
    (tmp_path / "p.nc").write_text(PROGRAMS["p.nc"])
    assert run("compensate", tmp_path / "p.nc", "-o", tmp_path / "o.nc", "-c", tmp_path / "mine.yaml") == 2
    assert run("control", "--to", "siemens", "-o", tmp_path / "t", "-c", tmp_path / "mine.yaml") == 2
    assert "did not settle" in capsys.readouterr().err
    assert not (tmp_path / "o.nc").exists() and not (tmp_path / "t").exists()


@pytest.mark.parametrize("kind", KINDS)
def test_a_calibration_file_keeps_its_warnings(kind: str, dmu50: Machine, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(calibration_text(kind))
    first = Calibration.load(tmp_path / "mine.yaml", dmu50)
    assert first.warnings == KINDS[kind][3]
    first.save(tmp_path / "again.yaml")
    again = Calibration.load(tmp_path / "again.yaml", dmu50)
    assert (again.simulated, again.settled, again.warnings) == (first.simulated, first.settled, first.warnings)
    assert first.with_control(None).warnings == first.warnings == first.where(lambda name: True).warnings


def test_simulated_is_true_or_false(dmu50: Machine, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(calibration_text("simulated").replace("true", "perhaps"))
    with pytest.raises(InputError, match=r"mine.yaml:4: `simulated` is invalid: 'perhaps'; expected true or false"):
        Calibration.load(tmp_path / "mine.yaml", dmu50)


def test_partly_unknown_uncertainty_has_its_own_warning(dmu50: Machine, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(calibration_text("nothing") + "squareness: {E_C0Y: 20.0}\n")
    assert Calibration.load(tmp_path / "mine.yaml", dmu50).warnings == (PARTLY_UNKNOWN_UNCERTAINTY,)
    assert Calibration.zero(dmu50).warnings == ()
    assert merge_warnings((PARTLY_UNKNOWN_UNCERTAINTY,), (SIMULATED, UNKNOWN_UNCERTAINTY), (SIMULATED,)) == (
        SIMULATED,
        PARTLY_UNKNOWN_UNCERTAINTY,
    )


# --- from the readings to the calibration ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def table(dmu50: Machine, calibration: Calibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a table of readings of X, as `twin simulate` writes it without a user comment."""
    plan = thesis_plan.plan(dmu50)
    moved = plan.select(np.ptp(plan.positions[:, 1:] - plan.positions[0, 1:], axis=1) == 0.0)
    readings, _ = simulate(moved, dmu50, calibration, LaserTracker(), np.random.default_rng(3))
    path = tmp_path_factory.mktemp("readings") / "simulated.csv"
    readings.save(path, dmu50)
    return path


def as_measured(path: Path) -> Path:
    """Return the same table without its comment."""
    other = path.parent / "measured.csv"
    other.write_text("".join(line for line in path.read_text().splitlines(True) if not line.startswith("#")))
    return other


def test_one_simulated_table_makes_all_simulated(dmu50: Machine, table: Path) -> None:
    real, drawn = Measurements.load(as_measured(table), dmu50), Measurements.load(table, dmu50)
    assert not real.simulated and drawn.simulated
    assert drawn.select(np.arange(10)).simulated
    other = replace(drawn, round=np.full(len(drawn), "later", dtype=object))
    assert (
        Measurements.join([real, other]).simulated
        and Measurements.join([other, real]).simulated
        and not Measurements.join([real]).simulated
    )


def test_a_comment_of_its_own_is_not_repeated(dmu50: Machine, table: Path, tmp_path: Path) -> None:
    Measurements.load(table, dmu50).save(tmp_path / "a.csv", dmu50, comment="Simulated by hand\nstation 1")
    assert (tmp_path / "a.csv").read_text().count("imulated") == 1
    assert Measurements.load(tmp_path / "a.csv", dmu50).simulated


def test_calibration_from_simulated_readings_has_the_warning(dmu50: Machine, table: Path) -> None:
    drawn, real = (identify(Measurements.load(path, dmu50), dmu50) for path in (table, as_measured(table)))
    assert drawn.calibration.simulated and not real.calibration.simulated
    assert drawn.calibration.curves.keys() == real.calibration.curves.keys()
    # The warning does not change any number.
    assert np.array_equal(drawn.calibration.covariance.matrix, real.calibration.covariance.matrix)
    assert SIMULATED.text in drawn.to_text() and SIMULATED.title not in real.to_text()
    # Only X moved: nothing is known of the other axes.
    assert [one["name"] for one in drawn.to_dict()["warnings"]] == ["simulated_readings", "not_identifiable"]


def test_standard_tests_have_the_warning(
    without_pictures: None, table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, report = tmp_path / "t.html", tmp_path / "t.json"
    for path, wanted in ((table, {SIMULATED.name}), (as_measured(table), set[str]())):
        assert run("evaluate", path, "--html", page, "--json", report) == 0
        printed = capsys.readouterr().out
        assert said(printed) == said(page.read_text()) == named(report) == wanted


def test_watch_has_the_warning(
    without_pictures: None, table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text(calibration_text("nothing"))
    for path, wanted in ((table, {SIMULATED.name}), (as_measured(table), set[str]())):
        folder, page, report = tmp_path / path.stem, tmp_path / "w.html", tmp_path / "w.json"
        folder.mkdir()
        (folder / "2026-03-02.csv").write_bytes(path.read_bytes())
        assert run("watch", folder, "-c", mine, "--html", page, "--json", report) == 0
        printed = capsys.readouterr().out
        assert said(printed) == said(page.read_text()) == named(report) == wanted


def test_thesis_method_has_the_warning(dmu50: Machine, calibration: Calibration) -> None:
    readings, _ = simulate(
        thesis_plan.plan(dmu50), dmu50, calibration, LaserTracker(), np.random.default_rng(3), noise=False
    )
    assert identify_as_thesis(readings, dmu50).calibration.simulated
    assert not identify_as_thesis(replace(readings, simulated=False), dmu50).calibration.simulated


def test_axis_run_has_the_warning(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    layout = AxisLayout.load(Path("twin/samples/nine_beams_x.yaml"), dmu50)
    q = np.tile(np.linspace(0.0, 500.0, 11), 2)
    readings, _ = simulate_run(layout, dmu50, calibration, q, np.random.default_rng(1))
    readings.save(tmp_path / "run.csv", layout)
    again = load_readings(tmp_path / "run.csv", layout)
    assert again.simulated and again.notices
    for simulated in (True, False):
        motions = error_motions(layout, replace(again, simulated=simulated))
        assert axis_curves(motions, dmu50, source="a run").calibration.simulated is simulated


# --- comments in programs ------------------------------------------------------------------------------------------------

NOTE: Final = ("twin: SIMULATED READINGS: made up.",)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("%\nO1 (A)\n(b)\nG0 X1\n", "%\nO1 (A)\n(twin: SIMULATED READINGS: made up.)\n(b)\nG0 X1\n"),
        ("%\r\nO1\r\nG0 X1\r\n", "%\r\nO1\r\n(TWIN: SIMULATED READINGS: MADE UP.)\r\nG0 X1\r\n"),
        ("(leader)\n%\n:12\nN10 G0 X1\n", "(leader)\n%\n:12\n(twin: SIMULATED READINGS: made up.)\nN10 G0 X1\n"),
        ("G0 X1 (a)\n%\n", "(twin: SIMULATED READINGS: made up.)\nG0 X1 (a)\n%\n"),
        ("G0 X1;\nG1 X2;\n", "(TWIN: SIMULATED READINGS: MADE UP.)\nG0 X1;\nG1 X2;\n"),
        ("; head\nG0 X1\n", "; twin: SIMULATED READINGS: made up.\n; head\nG0 X1\n"),
        ("%_N_A_MPF\n;$PATH=/N\nPROC A\nM5\n", "%_N_A_MPF\n;$PATH=/N\nPROC A\n; TWIN: SIMULATED READINGS: MADE UP.\nM5\n"),
        ("N10 TRAORI(1)\nN20 G0 X1", "; TWIN: SIMULATED READINGS: MADE UP.\nN10 TRAORI(1)\nN20 G0 X1"),
        ("\xef\xbb\xbfG0 X1 (a)\n", "\xef\xbb\xbf(twin: SIMULATED READINGS: made up.)\nG0 X1 (a)\n"),
    ],
)  # fmt: skip
def test_comments_follow_mandatory_first_lines(text: str, expected: str) -> None:
    assert Iso().with_comments(text, NOTE) == expected
    assert Iso().with_comments(expected, NOTE) == expected
    assert Iso().with_comments(text, ()) == text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "8 BEGIN PGM A MM\n9 CYCL DEF 32.0 T ~\n 9 MORE\n010 L X+1\n12 END PGM A MM\n",
            "8 BEGIN PGM A MM\n9 ; TWIN: SIMULATED READINGS: MADE UP.\n10 CYCL DEF 32.0 T ~\n 9 MORE\n011 L X+1\n13 END PGM A MM\n",
        ),
        ("BEGIN PGM a MM\r\nL X+1\r\n", "BEGIN PGM a MM\r\n; twin: SIMULATED READINGS: made up.\r\nL X+1\r\n"),
        ("L X+1\n", "; TWIN: SIMULATED READINGS: MADE UP.\nL X+1\n"),
        ("%\n0  BEGIN  PGM A MM\n1 M2", "%\n0  BEGIN  PGM A MM\n1 ; TWIN: SIMULATED READINGS: MADE UP.\n2 M2"),
    ],
)
def test_numbered_blocks_stay_in_order(text: str, expected: str) -> None:
    assert Heidenhain().with_comments(text, NOTE) == expected
    assert Heidenhain().with_comments(expected, NOTE) == expected


@pytest.mark.parametrize("dialect", DIALECTS, ids=lambda one: one.name)
def test_long_comments_are_wrapped_and_not_repeated(dialect: Any) -> None:
    text = PROGRAMS[{"iso": "p.nc", "heidenhain": "p.h", "apt": "p.cls"}[dialect.name]]
    once = dialect.with_comments(text, [f"twin: {one.text}" for one in EVERY])
    assert max(map(len, once.splitlines())) < 80
    assert said(once) == {one.name for one in EVERY}
    assert dialect.with_comments(once, [f"twin: {one.text}" for one in EVERY[:2]]) == once
    more = dialect.with_comments(
        dialect.with_comments(text, [f"twin: {SIMULATED.text}"]), [f"twin: {UNKNOWN_UNCERTAINTY.text}"]
    )
    assert said(more) == {SIMULATED.name, UNKNOWN_UNCERTAINTY.name}


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_compensated_twice_has_one_comment(name: str, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(calibration_text("all"))
    (tmp_path / name).write_text(PROGRAMS[name])
    first, second = tmp_path / f"a{Path(name).suffix}", tmp_path / f"b{Path(name).suffix}"
    assert run("compensate", tmp_path / name, "-o", first, "-c", tmp_path / "mine.yaml") == 0
    assert run("compensate", first, "-o", second, "-c", tmp_path / "mine.yaml") == 0
    head = [line for line in first.read_text().splitlines() if "SIMULATED" in line.upper()]
    assert [line for line in second.read_text().splitlines() if "SIMULATED" in line.upper()] == head
    assert len(head) == 1
    assert len(second.read_text().splitlines()) == len(first.read_text().splitlines())


def test_every_sentence_fits_into_a_comment() -> None:
    for one in (*EVERY, PARTLY_UNKNOWN_UNCERTAINTY):
        assert one.text.isascii() and not set(one.text) & set('()[]{};~$%"\n')
