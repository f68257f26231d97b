"""The whole watch on folders of the truth machine: what it finds, what it remembers, what it refuses."""

from __future__ import annotations

import json
import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
import yaml

import twin
from tests.cli.commands import refused
from tests.monitoring.folder import START, write_check, write_folder
from tests.truth.machine import TruthMachine
from twin import cli
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.monitoring.watch_page import news_text
from twin.monitoring.watched import date_text

CALIBRATION = Path(__file__).resolve().parents[2] / "urdf" / "dmu50.calibration.yaml"
STEP_URAD = 12.0
AFTER = 12
PER_KELVIN_UM = 3.0
SETTINGS = twin.WatchSettings(tolerance_mm=0.04)


def bed(i: int) -> dict[str, float]:
    return {"bed": 20.0 + 0.25 * i + 0.7 * float(np.sin(2.3 * i)), "hall": 21.0 + 0.8 * float(np.cos(1.7 * i))}


def changed(i: int, machine: TruthMachine, degrees: dict[str, float]) -> None:
    machine.squareness["E_C0Y"] += STEP_URAD * (i >= AFTER)
    machine.location["E_X0C"] += PER_KELVIN_UM * (degrees["bed"] - 20.0)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Checks of a machine whose Y tilts after check 12, and whose table grows with the bed's temperature."""
    folder = tmp_path_factory.mktemp("watch") / "checks"
    return write_folder(
        folder, TruthMachine(CALIBRATION), 18, seed=3, deviation=changed, temperatures=bed, repeatability=0.8
    )


@pytest.fixture(scope="module")
def watched(made: Path, dmu50: Machine, calibration: Calibration) -> twin.monitoring.Watch:
    return twin.watch(made, dmu50, calibration, settings=SETTINGS)


@pytest.fixture
def copy(made: Path, watched: twin.monitoring.Watch, tmp_path: Path) -> Path:
    """The folder with the memory of the first look."""
    shutil.copytree(made, tmp_path / made.name)
    shutil.copy(watched.memory, tmp_path)
    return tmp_path / made.name


def test_the_error_that_changed_is_found_with_date_and_size(watched: twin.monitoring.Watch) -> None:
    assert watched.verdict == "changed" and not watched.met
    assert [one.series.name for one in watched.alarms] == ["E_C0Y"]
    (one,) = watched.alarms
    assert one.change is not None and one.change.shape == "step"
    true = [check.day for check in watched.checks[AFTER - 1 : AFTER + 1]]
    assert one.change.earliest_day <= true[0] and true[1] <= one.change.latest_day
    assert one.change.latest_day - one.change.earliest_day < 21.0
    assert abs(one.change.size - STEP_URAD) <= one.change.expanded < 4.0
    assert "E_C0Y (squareness of Y about z) changed by" in watched.to_text()


def test_what_follows_a_temperature_is_no_change(watched: twin.monitoring.Watch) -> None:
    (one,) = watched.following
    assert one.series.name == "E_X0C" and one.temperatures[0].sensor == "bed"
    assert abs(one.temperatures[0].per_kelvin - PER_KELVIN_UM) <= one.temperatures[0].expanded
    assert "follows T_bed" in watched.to_text()


def test_what_the_checks_do_not_show_is_named(watched: twin.monitoring.Watch) -> None:
    """Spheres at unknown places show neither the common scale nor the positions that the places compensate."""
    assert {"E_X0B", "E_Y0B", "E_Y0C"} <= set(watched.not_determined)
    assert any("common scale" in text for text in watched.not_determined)
    assert {one.series.name for one in watched.errors}.isdisjoint(watched.not_determined)


def test_calibration_for_a_tolerance(
    made: Path, watched: twin.monitoring.Watch, dmu50: Machine, calibration: Calibration
) -> None:
    """The RMS is that of the truth machine with the last check's errors, less the one of the calibration, aligned."""
    left = watched.remaining
    assert left is not None and watched.good is True
    then, now = TruthMachine(CALIBRATION), TruthMachine(CALIBRATION)
    changed(17, now, bed(17))
    rng = np.random.default_rng(1)
    poses = rng.uniform([0, 0, -400, 0, 0], [500, 450, 0, 180, 360], (400, 5))
    points = [np.array([one.pose(q)[:3, 3] for q in poses]) for one in (then, now)]
    x, y, z = points[0].T
    o, l = np.zeros(400), np.ones(400)
    rows = np.stack([l, o, o, o, l, o, o, o, l, o, -z, y, z, o, -x, -y, x, o], axis=1).reshape(400, 6, 3)
    design = rows.transpose(0, 2, 1).reshape(-1, 6)
    off = (points[1] - points[0]).reshape(-1) * 1e3
    aligned = off - design @ np.linalg.lstsq(design, off, rcond=None)[0]
    assert left.rms_um == pytest.approx(float(np.sqrt(np.mean(aligned**2) * 3)), rel=0.15)
    assert left.max_um < left.upper_95_um < 40.0
    tight = twin.watch(made, dmu50, calibration, settings=twin.WatchSettings(tolerance_mm=0.02))
    assert tight.good is None and "cannot be decided" in tight.to_text()


def test_a_calibration_far_off_is_no_longer_good(made: Path, dmu50: Machine, tmp_path: Path) -> None:
    """No change either: the deviation was there from the first check on."""
    folder = tmp_path / "few"
    folder.mkdir()
    for path in sorted(made.iterdir())[:3]:
        shutil.copy(path, folder)
    data = yaml.safe_load(CALIBRATION.read_text())
    data["squareness"]["E_B0Z"] += 300.0
    (tmp_path / "off.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
    found = twin.watch(folder, dmu50, Calibration.load(tmp_path / "off.yaml", dmu50), settings=SETTINGS)
    assert found.verdict == "steady" and found.good is False and not found.met
    assert found.named("E_B0Z").level == pytest.approx(-300.0, abs=30.0)
    assert "no longer good" in found.to_text()


def test_the_same_folder_again_is_no_look(
    copy: Path, watched: twin.monitoring.Watch, dmu50: Machine, calibration: Calibration
) -> None:
    memory = copy.with_name(watched.memory.name)
    before = memory.read_bytes()
    again = twin.watch(copy, dmu50, calibration, settings=SETTINGS)
    assert memory.read_bytes() == before, "nothing was written"
    assert again.spent == watched.spent and again.statements == watched.statements
    assert again.to_text().replace(str(copy), "") == watched.to_text().replace(str(watched.folder), "")
    assert "nothing new" in news_text(again) and "18 new files" in news_text(watched)


def test_check_by_check_gives_the_same_as_all_at_once(
    made: Path, watched: twin.monitoring.Watch, dmu50: Machine, calibration: Calibration, tmp_path: Path
) -> None:
    folder = tmp_path / "checks"
    folder.mkdir()
    files = sorted(made.iterdir())
    spent = []
    for part in (files[:11], files[11:13], files[13:]):
        for path in part:
            shutil.copy(path, folder)
        found = twin.watch(folder, dmu50, calibration)
        spent.append(found.spent)
    assert [one.verdict for one in found.statements] == ["steady", "steady", "changed"]
    assert spent == sorted(spent) and spent[-1] == watched.spent < watched.alarm_rate
    for one, other in zip(found.errors, watched.errors, strict=True):
        assert one.log_evidence == pytest.approx(other.log_evidence, abs=1e-9) and one.verdict == other.verdict
    with sqlite3.connect(found.memory) as memory:
        assert memory.execute("SELECT count(*) FROM checks").fetchone() == (18,)
        assert memory.execute("SELECT count(*) FROM statements").fetchone() == (3,)


def test_an_sqlite_that_does_not_serialize_writes_the_same_memory(
    copy: Path,
    watched: twin.monitoring.Watch,
    dmu50: Machine,
    calibration: Calibration,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    memory = copy.with_name(watched.memory.name)
    last = sorted(copy.iterdir())[-1]
    shutil.copy(last, copy / "later_2026-09-01.csv")
    (copy / "later_2026-09-01.csv").write_text(last.read_text() + "\n")
    before = memory.read_bytes()
    found = []
    for serializes in (True, False):
        monkeypatch.setattr("twin.monitoring.watched.SERIALIZES", serializes)
        memory.write_bytes(before)
        found.append(twin.watch(copy, dmu50, calibration, settings=SETTINGS, now=START.replace(year=2027)))
        with sqlite3.connect(memory) as opened:
            found.append(list(opened.iterdump()))
            assert opened.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert found[1] == found[3] and found[0].to_text() == found[2].to_text() and len(found[2].checks) == 19
    assert sorted(path.name for path in copy.parent.iterdir()) == sorted([copy.name, memory.name]), (
        "no temporary file is left"
    )
    memory.write_bytes(b"SQLite format 3\0 and no more")
    with pytest.raises(twin.InputError, match="not a memory of a watch"):
        twin.watch(copy, dmu50, calibration, settings=SETTINGS)


def test_changed_vanished_and_copied_files_are_reported(
    copy: Path, watched: twin.monitoring.Watch, dmu50: Machine, calibration: Calibration
) -> None:
    first, second, third = sorted(copy.iterdir())[:3]
    first.write_text(first.read_text().replace("S1", "S9"))
    second.unlink()
    shutil.copy(third, copy / "copy_2026-03-30.csv")
    found = twin.watch(copy, dmu50, calibration, settings=SETTINGS)
    said = "\n".join(found.notices)
    assert f"{first.name} CHANGED" in said and f"{second.name} is no longer" in said
    assert f"copy_2026-03-30.csv (of {third.name})" in said
    assert len(found.checks) == 18 and found.named("E_C0Y").level == watched.named("E_C0Y").level


def test_another_alarm_rate_is_another_watch(copy: Path, dmu50: Machine, calibration: Calibration) -> None:
    found = twin.watch(
        copy, dmu50, calibration, settings=twin.WatchSettings(alarm_rate=0.01, since=START.replace(month=4))
    )
    assert len(found.statements) == 1 and min(check.date for check in found.checks) >= START.replace(month=4)
    assert any("1 other watch of this folder" in text for text in found.notices)


def run(*words: object) -> int:
    try:
        cli.main([str(word) for word in words])
    except SystemExit as stopped:
        return int(stopped.code or 0)
    return 0


def test_command(copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, report = tmp_path / "w.html", tmp_path / "w.json"
    assert run("watch", copy, "--html", page, "--json", report) == 3
    printed = capsys.readouterr().out
    found = json.loads(report.read_text())
    assert found["schema"] == "twin.watch/1" and found["verdict"] == "changed" and found["met"] is False
    (one,) = [error for error in found["errors"] if error["verdict"] == "changed"]
    assert one["name"] == "E_C0Y" and len(one["history"]) == 18
    text = page.read_text()
    for words in ("The machine changed between 2026-04-", "follows T_bed", "ILLUSTRATIVE"):
        assert words in text and words in printed
    assert text.index("The machine changed") < text.index("<h2>History")


def test_dates(dmu50: Machine, calibration: Calibration, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, truth, rng = tmp_path / "checks", TruthMachine(CALIBRATION), np.random.default_rng(1)
    folder.mkdir()
    write_check(folder / "a.csv", truth, rng, comment="measured 2026-05-01T23:30+02:00")
    write_check(folder / "b_20260503T0810.csv", truth, rng, comment="by hand")
    write_check(folder / "c.csv", truth, rng)
    assert "c.csv: no date" in refused(capsys, "watch", folder)
    assert not (tmp_path / "checks.watch.sqlite").exists()
    assert "not in the folder" in refused(capsys, "watch", folder, "--date", "d.csv=2026-05-05")
    assert "not a date" in refused(capsys, "watch", folder, "--date", "c.csv=5.5.2026")
    assert "FILE=DATE" in refused(capsys, "watch", folder, "--date", "c.csv")
    assert run("watch", folder, "--date", "c.csv=2026-05-05") == 0
    assert "3 checks the repeatability is hardly known" in capsys.readouterr().out.replace("\n    ", " ")
    found = twin.watch(folder, dmu50, calibration)
    assert [check.date.isoformat() for check in found.checks] == [
        "2026-05-01T21:30:00",
        "2026-05-03T08:10:00",
        "2026-05-05T00:00:00",
    ]
    assert [check.dated_by for check in found.checks] == ["comment of the table (UTC)", "file name", "given"]
    assert date_text(found.checks[0].day) == "2026-05-01"


def test_bad_input(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "checks"
    assert "cannot be read" in refused(capsys, "watch", folder)
    folder.mkdir()
    assert "no check in the folder" in refused(capsys, "watch", folder)
    whole = sorted(made.iterdir())[0].read_text()
    bad = folder / "2026-03-02.csv"
    bad.write_text(whole.replace(",30,90,", ",30,left,", 1))
    said = refused(capsys, "watch", folder)
    assert f"{bad}, line " in said or f"{bad}:" in said
    assert "C_deg is not a number" in said and "left" in said
    bad.write_text(whole)
    assert "no probability" in refused(capsys, "watch", folder, "--alarm-rate", 1.5)
    memory = tmp_path / "checks.watch.sqlite"
    for content in (b"notes", b"", b"SQLite format 3\0 and no more"):
        memory.write_bytes(content)
        assert "not a memory of a watch" in refused(capsys, "watch", folder)
        assert memory.read_bytes() == content, "it is never overwritten"
    memory.unlink()
    assert "two outputs are the same file" in refused(capsys, "watch", folder, "--json", memory)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["checks"]
