"""Tests of the start of a command: help, errors of use and of input, and completion import none of the large packages."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.cli.commands import refused
from twin.cli.commands import COMMANDS

HEAVY = {"numpy", "scipy", "casadi", "pinocchio", "matplotlib", "joblib", "jinja2", "yaml"}
LOADED = """
import sys
from twin.cli.commands import load
for name in sys.argv[2:]:
    load(name)
print(*({name.split(".")[0] for name in sys.modules} & set(sys.argv[1].split())))
"""
RUN = """
import contextlib, io, json, os, sys
from twin.cli import main
for arguments, completed in json.load(sys.stdin):
    words = ["twin", *arguments]
    variables = {"_TWIN_COMPLETE": "complete_bash", "COMP_WORDS": " ".join(words), "COMP_CWORD": str(len(words) - 1)}
    os.environ.update(variables if completed else {})
    printed = io.StringIO()
    status = None
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        try:
            main([] if completed else arguments)
        except SystemExit as stop:
            status = stop.code
    for name in variables:
        os.environ.pop(name, None)
    heavy = sorted({name.split(".")[0] for name in sys.modules} & set(sys.argv[1].split()))
    print(json.dumps([arguments, status, printed.getvalue(), heavy]))
    if heavy:
        break
"""


def test_no_command_imports_a_large_package_before_it_runs() -> None:
    ran = subprocess.run(
        [sys.executable, "-c", LOADED, " ".join({*HEAVY, "pydantic"}), *COMMANDS],
        capture_output=True,
        text=True,
        check=True,
    )
    assert ran.stdout.split() == []


def run_light(
    folder: Path, lines: Sequence[Sequence[str]], *, completed: bool = False, allowed: str = ""
) -> list[tuple[int, str]]:
    """Run command lines one after the other in one process; return status and output of each; fail at the first heavy import."""
    ran = subprocess.run(
        [sys.executable, "-c", RUN, " ".join(HEAVY - {allowed})],
        input=json.dumps([[list(line), completed] for line in lines]),
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    found = [json.loads(line) for line in ran.stdout.splitlines()]
    for arguments, _, _, heavy in found:
        assert heavy == [], arguments
    assert len(found) == len(lines)
    return [(status, text) for _, status, text, _ in found]


def test_help_and_unknown_options_import_no_large_package(tmp_path: Path) -> None:
    shown = run_light(tmp_path, [["--help"], ["--version"], *([name, "--help"] for name in COMMANDS)])
    assert all(status == 0 and text for status, text in shown)
    checked = [
        name for name in COMMANDS if name != "doctor"
    ]  # it first tries to import all packages, in another process
    for status, text in run_light(tmp_path, [[name, "--nonsense"] for name in checked]):
        assert status == 2 and "no such option: '--nonsense'" in text


WITH_MACHINE = {
    "info": [],
    "compare": ["a.yaml", "a.yaml"],
    "confirm": ["a.csv", "a.csv"],
    "volume": [],
    "forecast": ["cone_frustum.nc", "--features", "a.yaml"],
    "check": ["cone_frustum.nc"],
    "compensate": ["cone_frustum.nc", "-o", "x.nc"],
    "verify": ["cone_frustum.nc", "--control", "linuxcnc"],
    "path": ["cone_frustum.nc", "-o", "x.nc"],
    "scene": ["cone_frustum.nc", "-o", "x.html"],
    "simulate": ["thesis_plan.csv", "-o", "x.csv"],
    "import": ["shop_table.csv", "-o", "x.csv"],
    "convert": ["a.csv", "-o", "x.csv"],
    "identify": ["a.csv", "-o", "x.yaml"],
    "axis-run": ["a.csv", "-o", "x.yaml", "--layout", "nine_beams_x.yaml"],
    "simulate-run": ["-o", "x.csv", "--layout", "nine_beams_x.yaml", "--positions", "0,500,21"],
    "evaluate": ["a.csv"],
    "diagnose": ["a.csv"],
    "watch": ["."],
    "plan": ["-o", "x.csv"],
    "report": ["-o", "x.html"],
    "control": ["--to", "isg", "-o", "x"],
    "thermal": ["warm_up.csv", "--extended", "x.yaml"],
}
"""Arguments of every command that loads a machine."""


def test_a_misspelt_machine_imports_no_large_package(tmp_path: Path) -> None:
    for name in ("a.csv", "a.yaml"):
        (tmp_path / name).write_text("")
    assert set(WITH_MACHINE) == set(COMMANDS) - {"machine", "demo", "doctor", "doc"}
    lines = [[name, *more, "--machine", "dmu5"] for name, more in WITH_MACHINE.items()]
    for status, text in run_light(tmp_path, lines):
        assert status == 2 and "dmu5: not found (did you mean dmu50?)" in text


def test_errors_of_input_import_no_large_package(tmp_path: Path) -> None:
    lines = {
        "info -c nosuch.yaml": "nosuch.yaml: cannot be read",
        "info -o x.yaml": "--output needs --datum",
        "compare nosuch.yaml nosuch.yaml": "nosuch.yaml: cannot be read",
        "compensate nosuch.nc -o x.nc": "nosuch.nc: no such program",
        "compensate cone_frustum.nc -o x.nc --tolerance -1": "--tolerance must be positive",
        "path nosuch.nc -o x.nc": "nosuch.nc: no such program",
        "scene nosuch.nc -o x.html": "nosuch.nc: no such program",
        "simulate nosuch.csv -o x.csv": "nosuch.csv: no such plan",
        "simulate thesis_plan.csv -o x.csv --instrument trackr": "no such instrument: 'trackr' (did you mean tracker?)",
        "identify thesis_plan.csv -o x.yaml --instrument trackr": "no such instrument: 'trackr' (did you mean tracker?)",
        "import nosuch.csv -o x.csv": "nosuch.csv: no such table",
        "convert nosuch.csv -o x.csv": "nosuch.csv: cannot be read",
        "identify nosuch.csv -o x.yaml": "nosuch.csv: cannot be read",
        "axis-run nosuch.csv -o x.yaml --layout nine_beams_x.yaml": "nosuch.csv: cannot be read",
        "evaluate nosuch.csv": "nosuch.csv: cannot be read",
        "thermal nosuch.csv": "nosuch.csv: cannot be read",
        "diagnose nosuch.csv": "nosuch.csv: cannot be read",
        "watch nosuch": "nosuch: the folder of checks cannot be read",
        "plan": "no output, or two outputs",
        "plan -o x.csv --seed -1": "--seed must not be negative",
        "plan -o x.csv --instrument trackr": "no such instrument: 'trackr' (did you mean tracker?)",
        "report -o x.txt": "wrong suffix of the output file",
        "control": "no output chosen",
        "control --to fanuk -o x": "is not one of 'linuxcnc'",
        "machine new": "no output given",
        "machine check dmu5": "dmu5: not found (did you mean dmu50?)",
        "doc nosuch": "no such page: 'nosuch'",
    }
    for (status, text), expected in zip(
        run_light(tmp_path, [line.split() for line in lines]), lines.values(), strict=True
    ):
        assert status == 2 and expected in text
    assert list(tmp_path.iterdir()) == []


def test_completion_imports_no_large_package(tmp_path: Path) -> None:
    lines = {
        "": "compensate",
        "compensate --": "--calibration",
        "compensate cone": "cone_frustum.nc",
        "compensate x.nc --machine ": "dmu50",
        "compensate x.nc --scope L": "L-VOL+",
        "simulate ": "thesis_plan.csv",
        "simulate p.csv --instrument ": "ball-bar",
        "plan --kit ": "dmu50",
        "plan --separate ": "gravity_compliance",
        "plan --sequence ": "circles",
        "plan --drift ": "spindle",
        "control --to ": "siemens_eec",
        "control --kinematics ": "fanuc-five-axis",
        "convert --format ": "renishaw-laser",
        "doc ": "datum",
    }
    found = run_light(tmp_path, [line.split(" ") for line in lines], completed=True)
    for (_, text), expected in zip(found, lines.values(), strict=True):
        assert expected in text.splitlines()


def test_completion_of_error_names_imports_only_what_reads_yaml(tmp_path: Path) -> None:
    lines = ["plan --reduce E_C0", "identify m.csv -m xyzbc_trunnion --only E_C0", "plan --machine none --reduce E_C0"]
    for _, text in run_light(tmp_path, [line.split(" ") for line in lines], completed=True, allowed="yaml"):
        assert "E_C0Y" in text.splitlines()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("identify", "m.csv", "-o", "x.yaml"), "m.csv: cannot be read"),
        (("compensate", "part.nc", "-o", "x.nc"), "part.nc: no such program"),
        (("compensate", "cone_frustum.n", "-o", "x.nc"), "(did you mean cone_frustum.nc"),
        (("report", "-o", "x.html", "-c", "mine.yaml"), "mine.yaml: cannot be read"),
        (("simulate", "thesis_plan.cs", "-o", "x.csv"), "(did you mean thesis_plan.csv"),
        (("diagnose", "measured.csv"), "(did you mean measured1.csv"),
        (("control", "--to", "fanuk", "-o", "x"), "not one of 'linuxcnc'"),
    ],
)
def test_a_missing_input_is_named(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: tuple[str, ...],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "measured1.csv").write_text("")
    assert message in refused(capsys, *arguments)
    assert [file.name for file in tmp_path.iterdir()] == ["measured1.csv"]


def test_no_time_is_spent_on_searching_for_cycles_at_the_end() -> None:
    program = (
        "import atexit, gc\n"
        "atexit.register(lambda: print('frozen', gc.get_freeze_count() > 0))\n"
        "from twin.cli import main\n"
        "try:\n    main(['--version'])\n"
        "except SystemExit:\n    print(gc.get_threshold()[0])\n"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines()[1:] == ["20000", "frozen True"]
