"""Behaviour common to all commands: working examples, one-line errors with the nearest valid name, JSON, completion, doctor."""

from __future__ import annotations

import json
import pickle
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from twin import cli
from twin._common.errors import InputError, closest_name, did_you_mean
from twin._common.families import NAMES
from twin.cli import commands
from twin.cli.commands import load
from twin.cli.shared.terminal import MANY_WORDS, repeat_options
from twin.compute.native import compiler

COMMANDS: dict[str, Any] = {name: load(name) for name in commands.COMMANDS}
EXAMPLES = [
    (name, line.strip())
    for name, command in COMMANDS.items()
    for line in (command.epilog or "").splitlines()
    if line.strip().startswith("twin ")
]
CALIBRATION = "schema: twin.calibration/1\nmachine: DMU 50 eVolution\nsource: a test\n"


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stopped:
        cli.main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out, captured.err


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    status, _, err = run(capsys, *arguments)
    assert status == 2 and err.count("\n") == 1 and err.startswith("twin: ") and "expected" in err, err
    return err


def completed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], line: str) -> list[str]:
    """Return the completions that bash shows at the end of a line."""
    monkeypatch.setenv("_TWIN_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(line.split()) - (0 if line.endswith(" ") else 1)))
    with pytest.raises(SystemExit):
        cli.main([])
    return capsys.readouterr().out.split("\n")[:-1]


@pytest.mark.sample(7)  # of 21
@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_a_short_help_and_can_be_quiet(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    short, long = run(capsys, name, "-h"), run(capsys, name, "--help")
    assert short == long and short[0] == 0 and "--quiet" in short[1]


def test_version_and_quiet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "--version") == (0, f"twin {twin.__version__}\n", "")
    assert run(capsys, "-h")[1] == run(capsys, "--help")[1]
    assert run(capsys, "info", "--quiet", "--json", tmp_path / "info.json") == (0, "", "")
    assert (tmp_path / "info.json").is_file()
    assert run(capsys, "volume", "--quiet", "--calibration", tmp_path / "none.yaml")[:2] == (2, "")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_writes_json_and_gives_two_examples_or_more(name: str) -> None:
    assert any("--json" in one.opts for one in COMMANDS[name].params)
    assert sum(own == name for own, _ in EXAMPLES) >= 2


@pytest.mark.parametrize(("name", "line"), EXAMPLES)
def test_every_example_is_a_command_line_that_parses(name: str, line: str) -> None:
    words = repeat_options(shlex.split(line))
    assert words[0] == "twin" and words[1] in COMMANDS
    context = COMMANDS[words[1]].make_context(words[1], words[2:])
    assert context.params


def test_help_shows_examples_on_their_own_lines(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "info", "--help")
    assert status == 0
    shown = [line.strip() for line in out.splitlines()]
    assert all(line in shown for name, line in EXAMPLES if name == "info" and len(line) < 70)


def test_examples_run(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the examples that are fast and need only bundled files."""
    monkeypatch.chdir(tmp_path)
    fast = ("twin doctor --", "twin info --machine", "twin simulate-run", "twin axis-run", "twin import shop_table")
    ran = []
    for _, line in EXAMPLES:
        if line.startswith(fast) and "mine.yaml" not in line:
            status, _, err = run(capsys, *shlex.split(line)[1:])
            assert status == 0, (line, err)
            ran.append(line)
    assert len(ran) >= 6
    assert json.loads((tmp_path / "quiet.json").read_text())["schema"] == "twin.simulated_run/1"
    report = json.loads((tmp_path / "doctor.json").read_text())
    assert report["schema"] == "twin.doctor/1" and report["ok"] is True


@pytest.mark.slow
def test_json_holds_the_numbers_that_are_printed(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    status, out, _ = run(capsys, "info", "--tool-length", 120, "--json", tmp_path / "info.json")
    report = json.loads((tmp_path / "info.json").read_text())
    assert status == 0 and report["schema"] == "twin.info/1" and report["illustrative"] is True
    (row,) = (one for one in report["errors"] if one["name"] == "E_ZZ")
    assert f"{row['tool_rms_um']:.2f} µm" in out and f"{row['tool_max_um']:.2f} µm" in out
    assert report["classes"][-1]["name"] == "all" and report["uncertainty"]["known"] is False
    assert [axis["name"] for axis in report["axes"]] == ["X", "Y", "Z", "B", "C"]

    part, scene = tmp_path / "part.nc", tmp_path / "scene.json"
    part.write_text("G21 G90\nG1 X100 Y100 Z-100 B30 C40 F500\nX120 B35\nM30\n")
    status, out, _ = run(capsys, "scene", part, "-o", tmp_path / "s.html", "--json", scene)
    report = json.loads(scene.read_text())
    assert status == 0 and report["schema"] == "twin.scene/1" and report["left_out"] == 0
    # Compare the two end points of the only feed block with the kinematics.
    machine = twin.Machine.load("dmu50")
    real, drawn = (
        twin.Kinematics(machine, one) for one in (twin.Calibration.default(machine), twin.Calibration.zero(machine))
    )
    q = [[100.0, 100.0, -100.0, 30.0, 40.0], [120.0, 100.0, -100.0, 35.0, 40.0]]
    ends = np.linalg.norm(real.forward(q).point_mm - drawn.forward(q).point_mm, axis=1) * 1e3
    assert report["deviation_um"]["max"] >= ends.max() * (1.0 - 1e-6)

    status, out, _ = run(
        capsys, "simulate", "thesis_plan.csv", "-o", tmp_path / "m.csv", "--json", tmp_path / "m.json", "--seed", 3
    )
    report = json.loads((tmp_path / "m.json").read_text())
    assert status == 0 and report["schema"] == "twin.simulation/1" and report["seed"] == 3
    assert f"{report['points']} points" in out


def test_a_report_never_replaces_an_input(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text(CALIBRATION)
    for arguments in (
        ("info", "-c", mine, "--json", mine),
        ("simulate", "thesis_plan.csv", "-o", tmp_path / "m.csv", "-c", mine, "--json", mine),
        ("compare", mine, mine, "--json", mine),
    ):
        assert "input" in refused(capsys, *arguments)
    assert mine.read_text() == CALIBRATION


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (("compensat", "a.nc"), "compensate"),
        (("info", "--machin", "x"), "--machine"),
        (("info", "--tol-length", "3"), "--tool-length"),
        (("info", "-m", "dmu5"), "dmu50"),
        (("compensate", "cone_frustum.n", "-o", "x.nc"), "cone_frustum.nc"),
        (("compensate", "cone_frustum.nc", "-o", "x.nc", "--method", "exat"), "exact"),
        (("compensate", "cone_frustum.nc", "-o", "x.nc", "--scope", "l-pso"), "L-POS"),
        (("compensate", "cone_frustum.nc", "-o", "x.nc", "--work-offset", "x=3"), "X"),
        (("compensate", "cone_frustum.nc", "-o", "x.nc", "--temperature", "y=21"), "Y"),
        (("simulate", "thesis_pla.csv", "-o", "x.csv"), "thesis_plan.csv"),
        (("simulate", "thesis_plan.csv", "-o", "x.csv", "--instrument", "traker"), "tracker"),
        (("identify", "thesis_plan.csv", "-o", "x.yaml", "--only", "E_C0X"), "E_"),
        (("evaluate", "thesis_plan.csv", "--instrument", "traker"), "tracker"),
        (("plan", "-o", "x.csv", "--drift", "spindel"), "spindle"),
        (("plan", "-o", "x.csv", "--reduce", "tol"), "tool"),
        (("plan", "-o", "x.csv", "--kit", "dmu5"), "dmu50"),
        (("simulate-run", "-l", "nine_beam_x.yaml", "--positions", "0,500,3", "-o", "x.csv"), "nine_beams_x.yaml"),
    ],
)
def test_unknown_name_gives_the_nearest_valid_one(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    meant: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert f"(did you mean {meant}" in refused(capsys, *arguments)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("curvs: {}\n", "curves"),
        ("squareness: {E_C0X: 3.0}\n", "E_C0Y"),
        ("curves: {E_XX: {unit: um, domain: [0, 500], basis: powr, coefficients: [0]}}\n", "power"),
        ("curves: {E_XX: {unitt: um, domain: [0, 500], basis: power, coefficients: [0]}}\n", "unit"),
        ("effects: [{effect: revrsal, where: Y, parameters: {size: 3}}]\n", "reversal"),
        ("effects: [{effect: reversal, where: y, parameters: {size: 3}}]\n", "Y"),
        ("effects: [{effect: reversal, where: Y, parameters: {sise: 3}}]\n", "size"),
        ("effects: [{effect: cross_axis, where: E_ZY by z, parameters: {coefficient: 3}}]\n", "E_ZY by Z"),
    ],
)
def test_errors_in_files_give_line_and_nearest_name(tmp_path: Path, text: str, meant: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(CALIBRATION + text)
    with pytest.raises(InputError) as stopped:
        twin.Calibration.load(path, twin.Machine.load("dmu50"))
    assert stopped.value.line == 4 and stopped.value.nearest == meant
    assert f"(did you mean {meant}?)" in str(stopped.value)


def test_errors_in_columns_give_the_nearest_name(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    table = tmp_path / "m.csv"
    table.write_text("X_mn,Y_mm,Z_mm,B_deg,C_deg,target,carrier,x_mm,y_mm,z_mm\n1,2,3,4,5,K,tool,1,2,3\n")
    assert "X_mm is missing (the table has X_mn)" in refused(capsys, "identify", table, "-o", tmp_path / "x.yaml")


def test_nearest_ignores_case_and_may_find_nothing() -> None:
    assert closest_name("e_xx", ["E_XX", "E_YY"]) == "E_XX"
    assert closest_name("x_m", ["X_mm", "x_mm"]) == "x_mm" and closest_name("X_m", ["X_mm", "x_mm"]) == "X_mm"
    assert (
        closest_name("qqqq", ["E_XX"]) is None and did_you_mean("qqqq", ["E_XX"]) == "" and closest_name("", []) is None
    )
    error = InputError("no such thing", expected="one of a, b", value="c", nearest="b")
    # A worker's error arrives unchanged.
    assert (
        str(pickle.loads(pickle.dumps(error)))
        == str(error)
        == "no such thing: 'c' (did you mean b?); expected one of a, b"
    )


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("compensate", "a.nc"), "--output"),
        (("info", "extra"), "extra"),
        (("info", "--tool-length", "long"), "--tool-length"),
        (("compare", "a.yaml"), "NEWER"),
    ],
)
def test_usage_error_is_one_line(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str) -> None:
    line = refused(capsys, *arguments)
    assert said in line and f"twin {arguments[0]} --help" in line


def test_help_without_arguments(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys)
    assert status == 2 and "compensate" in out


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("twin comp", {"compare", "compensate"}),
        ("twin info -m ", {"dmu50", "trunnion_ac", "xyzbc_trunnion", "my.yaml"}),
        ("twin info -c m", {"my.yaml"}),
        ("twin compensate cone", {"cone_frustum.cls", "cone_frustum.h", "cone_frustum.nc"}),
        ("twin compensate a.nc --scope R-", {"R-POS", "R-RAX", "R-POR", "R-ANG", "R-VOL", "R-VOL+"}),
        ("twin compensate a.nc --scope L-POS FO", {"FOR"}),
        ("twin simulate p.csv --instrument tracker", {"tracker", "tracker-absolute"}),
        ("twin identify m.csv --only E_C0", {"E_C0Y"}),
        ("twin plan --kit d", {"dmu50"}),
        ("twin plan --drift s", {"spindle"}),
        ("twin plan --reduce we", {"weakest"}),
        (
            "twin plan --separate the",
            {"thermal_drift", "thermal_expansion", "thermal_growth", "thermal_lag", "thermal_tilt"},
        ),
        ("twin axis-run r.csv --layout n", {"nine_beams_x.yaml"}),
    ],
)
def test_the_shell_completes_names(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    line: str,
    offered: set[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.yaml").write_text("")
    (tmp_path / "notes.md").write_text("")
    found = set(completed(monkeypatch, capsys, line))
    assert found == offered


def test_the_shell_completes_the_names_of_the_machine_that_was_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "E_AA" in completed(monkeypatch, capsys, "twin identify m.csv -m trunnion_ac --only E_A")


def test_doctor_reports_failures_and_remedies(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Run doctor with two formulations of the kinematics that disagree by 1 µm, and without a compiler."""
    own = twin.Machine.configuration

    def off(self: twin.Machine, q: np.ndarray, errors: np.ndarray | None = None) -> np.ndarray:
        found = own(self, q, errors).copy()
        found[self.model.joints[self.axis_joints[0]].idx_q] += 1e-6
        return found

    monkeypatch.setattr(twin.Machine, "configuration", off)
    monkeypatch.setattr(compiler, "find_compiler", lambda: None)
    status, out, _ = run(capsys, "doctor", "--json", tmp_path / "d.json")
    report = json.loads((tmp_path / "d.json").read_text())
    assert status == 3 and report["failed"] == ["kinematics"] and report["ok"] is False
    by_name = {one["name"]: one for one in report["findings"]}
    assert by_name["C++ compiler"]["status"] == "missing" and by_name["inverse"]["status"] == "ok"
    assert by_name["kinematics"]["remedy"] in out and "FAILED: kinematics" in out
    assert report["seconds"] < 2.0 * 5.0  # two seconds on an idle computer


def test_every_class_is_a_word_of_scope() -> None:
    assert all(MANY_WORDS["--scope"].fullmatch(name) for name in NAMES)
