"""Messages of every command with the calibration of a kinematics module in the control, or with errors that remain with it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

import twin
from twin import cli
from twin.cli.identify import tables_on
from twin.compensation.live import errors_while_on, make_module, write_module

MINE = """
schema: twin.calibration/1
machine: DMU 50 eVolution
source: by hand
curves:
  E_XX: {unit: um, domain: [0, 500], basis: power, coefficients: [3.0, 9.0]}
squareness: {E_C0Y: 60.0}
location: {E_X0C: 25.0, E_A0B: -40.0}
covariance:
  parameters: ['E_XX[0]', 'E_XX[1]', E_C0Y, E_X0C, E_A0B]
  lower: |
    1.0
    0.2 2.0
    0 0 4.0
    0 0 0 9.0
    0 0 0 0 4.0
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dmu50: twin.Machine) -> Path:
    """Return a folder with a calibration, the folder of its module, and what remained with it."""
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text(MINE)
    mine = twin.Calibration.load("mine.yaml", dmu50)
    write_module(make_module(mine), Path("live"))
    section = tables_on(["linuxcnc-kinematics=live/calibration.yaml"], dmu50)
    replace(mine, location={"E_X0C": 4.0}, squareness={}, joint=None).with_control(section).save(Path("left.yaml"))
    return tmp_path


def status(words: Sequence[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    with pytest.raises(SystemExit) as raised:
        cli.main(list(words))
    said = capsys.readouterr()
    return int(raised.value.code or 0), said.out + said.err


REFUSED = (
    "compensate cone_frustum.nc -o out.nc",
    "path cone_frustum.nc -o out.nc --tolerance 0.02",
    "control --to siemens -o tables",
    "control --to linuxcnc -o tables",
    "control --kinematics siemens-chain -o tables",
    "control --to linuxcnc-kinematics -o again",
    "diagnose thesis_plan.csv --extended out.yaml",
)


@pytest.mark.parametrize("words", REFUSED)
def test_nothing_corrects_these_errors_a_second_time(
    folder: Path, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(folder.iterdir())
    code, said = status([*words.split(), "-c", "live/calibration.yaml"], capsys)
    assert code == 2 and "a kinematics module in the control corrects these errors" in said and "corrected.yaml" in said
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("control --to siemens -o tables", "measured with a kinematics module active"),
        ("control --to linuxcnc --add -o tables", "measured with a kinematics module active"),
        ("control --kinematics siemens-chain -o tables", "measured with a kinematics module active"),
        ("control --to linuxcnc-kinematics -o again", "(--add)"),
    ],
)
def test_beside_the_module_there_are_no_tables(
    folder: Path, words: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(folder.iterdir())
    code, said = status([*words.split(), "-c", "left.yaml"], capsys)
    assert code == 2 and says in said and sorted(folder.iterdir()) == before


def test_what_remains_is_compensated_or_added(
    folder: Path, capsys: pytest.CaptureFixture[str], dmu50: twin.Machine
) -> None:
    code, said = status("compensate cone_frustum.nc -o out.nc -c left.yaml".split(), capsys)
    assert code == 0 and "measured with its kinematics module active (corrected.yaml): keep it active" in said
    code, _ = status("control --to linuxcnc-kinematics --add -o both -c left.yaml".split(), capsys)
    assert code == 0
    (held,) = tables_on(["linuxcnc-kinematics=both/calibration.yaml"], dmu50).live
    assert held.file.resolve() == Path("both/corrected.yaml").resolve()
    assert twin.Calibration.load(held.file, dmu50).location["E_X0C"] == 29.0
    code, said = status("compensate cone_frustum.nc -o out.nc -c both/calibration.yaml".split(), capsys)
    assert code == 2 and "with the module switched off, the calibration corrected.yaml" in said


def test_the_report_advises_to_keep_the_module(
    without_pictures: None, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status("report -c live/calibration.yaml -o r.html --json r.json --tool-length 120".split(), capsys)
    summary = json.loads(Path("r.json").read_text())["summary"]
    assert summary["headline"].startswith(
        "With the correction in the control switched off, the error at the tool point is"
    )
    steps = {(step["kind"], step["title"]): step["text"] for step in summary["steps"]}
    kept = steps["do", "Keep the correction in the control switched on"]
    assert "Programs run as they are." in kept and "RMS are expected, from the uncertainty of the calibration" in kept
    assert [kind for kind, _ in steps].count("do") == 1, "neither programs nor tables nor adjustment"
    assert ("never", "Compensate programs or write tables beside the module") in steps
    assert "linuxcnc-kinematics=calibration.yaml" in steps["measure", "Measure what remains"]
    assert "corrected.yaml (linuxcnc-kinematics)" in Path("r.html").read_text()
    status("report -c left.yaml -o r.html --json r.json --tool-length 120".split(), capsys)
    steps = {step["title"]: step["text"] for step in json.loads(Path("r.json").read_text())["summary"]["steps"]}
    assert "--add --calibration left.yaml" in steps["Keep the correction in the control switched on"]
    assert "Compensate the programs" in steps
    assert not any("use the control's axis tables" in title.lower() for title in steps)


def test_errors_that_remain_under_another_module_are_not_compared(
    folder: Path, capsys: pytest.CaptureFixture[str], dmu50: twin.Machine
) -> None:
    left = twin.Calibration.load("left.yaml", dmu50)
    write_module(make_module(replace(left, location={"E_X0C": 9.0}).with_control(None)), Path("other"))
    section = tables_on(["linuxcnc-kinematics=other/calibration.yaml"], dmu50)
    left.with_control(section).save(Path("other.yaml"))
    code, said = status("compare left.yaml other.yaml".split(), capsys)
    assert code == 2 and "remaining under different kinematics modules" in said
    code, said = status("compare left.yaml mine.yaml".split(), capsys)
    assert code == 2 and "one calibration gives the machine's own errors" in said
    code, said = status("compare live/calibration.yaml mine.yaml".split(), capsys)
    assert code == 0 and "without the kinematics module of the control, which corrects them" in " ".join(said.split())


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        (["linuxcnc-kinematics=mine.yml"], "cannot be read"),
        (["linuxcnc-kinematics=live/calibration.yaml", "linuxcnc=X.comp"], "names a kinematics module and more"),
        (["linuxcnc-kinematic=live/calibration.yaml"], "did you mean linuxcnc-kinematics"),
    ],
)
def test_another_module_is_refused(folder: Path, dmu50: twin.Machine, entries: list[str], says: str) -> None:
    with pytest.raises(twin.InputError, match=says):
        tables_on(entries, dmu50)


def test_a_module_whose_calibration_has_changed_is_refused(folder: Path, dmu50: twin.Machine) -> None:
    path = Path("live/corrected.yaml")
    path.write_text(path.read_text().replace("25.0", "26.0"))
    with pytest.raises(twin.InputError, match="the active corrections are unknown"):
        tables_on(["linuxcnc-kinematics=live/calibration.yaml"], dmu50)


def test_the_machine_with_the_module_on_has_no_errors_and_the_same_uncertainty(
    folder: Path, dmu50: twin.Machine
) -> None:
    live = twin.Calibration.load("live/calibration.yaml", dmu50)
    on = errors_while_on(live)
    q = [[100.0, 50.0, -50.0, 30.0, 45.0]]
    nominal, real, without = (
        twin.Kinematics(dmu50, one, tool_length_mm=100.0).forward(q).point_mm
        for one in (twin.Calibration.zero(dmu50), on, live)
    )
    assert real == pytest.approx(nominal, abs=1e-12) and abs(without - nominal).max() > 1e-3
    assert on.covariance.names == live.covariance.names and on.control is None
