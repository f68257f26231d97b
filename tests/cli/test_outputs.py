"""No command overwrites its inputs, replaces a file that is not regular, or leaves temporary files after being ended."""

from __future__ import annotations

import json
import os
import platform
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, get_type_hints

import pytest

import twin
from tests.cli.commands import TWIN, refused
from tests.measurement.formats.cases import CASES as MEASURED
from tests.measurement.importing import shop_files
from twin import cli
from twin._common.bundled import bundled_folder
from twin._common.errors import InputError
from twin._common.files import TEMPORARY_PREFIX, atomic_file, check_writable, read_bytes, tracked_files, write_atomic
from twin.cli import commands
from twin.cli.shared.command import path_parameters

PART = "G90\nG0 X100 Y100 Z-100 B30 C10\nG1 X110 F500\nX100\n"
BUNDLED = bundled_folder()


@pytest.fixture(autouse=True)
def hang_up_is_not_ignored() -> Iterator[None]:
    """Tests run under nohup ignore SIGHUP, and so do their child processes: the commands then go on, as they should."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with one input of every kind; tests work on copies of it."""
    folder = tmp_path_factory.mktemp("shop")
    for name in ("dmu50.yaml", "dmu50.urdf", "dmu50.calibration.yaml"):
        shutil.copy(BUNDLED / name, folder / name)
    (folder / "p.nc").write_text(PART)
    (folder / "q.nc").write_text(PART)
    shutil.copy(folder / "dmu50.calibration.yaml", folder / "c.yaml")
    plan = Path(cli.__file__).parents[1] / "samples" / "thesis_plan.csv"
    (folder / "plan.csv").write_text("".join(plan.read_text().splitlines(keepends=True)[:40]))
    (folder / "drift.csv").write_text("time_s,a_um\n0,0\n60,1\n")
    (folder / "contacts.csv").write_text(MEASURED["contacts"].GOOD)
    (folder / "shop.csv").write_bytes(shop_files.cmm_report())
    twin.import_table(folder / "shop.csv", twin.Machine.load("dmu50")).save_columns(folder / "columns.yaml")
    with pytest.raises(SystemExit) as ended:
        cli.main(["control", "--to", "siemens", "-o", str(folder / "tables"), "--json", str(folder / "report.json")])
    assert ended.value.code == 0
    return folder


COMMANDS = {
    "compensate, json over the calibration": ("compensate p.nc -o o.nc -c c.yaml --json c.yaml", "c.yaml"),
    "compensate, report over the calibration": ("compensate p.nc -o o.nc -c c.yaml --report c.yaml", "c.yaml"),
    "compensate, json over the machine": ("compensate p.nc -o o.nc -m dmu50.yaml --json dmu50.yaml", "dmu50.yaml"),
    "compensate, json over the URDF": ("compensate p.nc -o o.nc -m dmu50.yaml --json dmu50.urdf", "dmu50.urdf"),
    "compensate, json over the machine's calibration": (
        "compensate p.nc -o o.nc -m dmu50.yaml --json dmu50.calibration.yaml",
        "dmu50.calibration.yaml",
    ),
    "compensate several, json over one": ("compensate p.nc q.nc -o out --json p.nc", "p.nc"),
    "compensate several, json over the calibration": ("compensate p.nc q.nc -o out -c c.yaml --json c.yaml", "c.yaml"),
    "compensate over a symbolic link": ("compensate p.nc -o link.nc", "p.nc"),
    "compensate over a hard link": ("compensate p.nc -o hard.nc", "p.nc"),
    "path, json over the calibration": ("path p.nc -o o.nc -c c.yaml --json c.yaml", "c.yaml"),
    "path over the machine": ("path p.nc -o dmu50.yaml -m dmu50.yaml", "dmu50.yaml"),
    "identify over the machine": ("identify plan.csv -m dmu50.yaml -o dmu50.yaml", "dmu50.yaml"),
    "identify, json over the URDF": ("identify plan.csv -m dmu50.yaml -o o.yaml --json dmu50.urdf", "dmu50.urdf"),
    "identify, json over a control's table": (
        "identify plan.csv -o o.yaml --control siemens=tables/cec.mpf --json tables/cec.mpf",
        "tables/cec.mpf",
    ),
    "evaluate, json over the machine": ("evaluate plan.csv -m dmu50.yaml --json dmu50.yaml", "dmu50.yaml"),
    "evaluate, json over the table": ("evaluate plan.csv --json plan.csv", "plan.csv"),
    "watch, json over a check": ("watch . --json plan.csv", "plan.csv"),
    "watch, page over the machine's copy": ("watch tables -m dmu50.yaml --json dmu50.urdf", "dmu50.urdf"),
    "evaluate, json over the record": ("evaluate drift.csv --iso230-3 --json drift.csv", "drift.csv"),
    "plan of a drift test over the kit": (
        "plan --drift environment --kit p.nc -o o.csv --json p.nc",
        "p.nc",
    ),
    "thermal over the record": ("thermal plan.csv --predicted plan.csv", "plan.csv"),
    "thermal, json over the record to predict": ("thermal contacts.csv --predict plan.csv --json plan.csv", "plan.csv"),
    "thermal, json over the model": ("thermal plan.csv --model c.yaml --json c.yaml", "c.yaml"),
    "diagnose, json over the machine": ("diagnose plan.csv -m dmu50.yaml --json dmu50.yaml", "dmu50.yaml"),
    "diagnose, extended over the calibration": ("diagnose plan.csv -c c.yaml --extended c.yaml", "c.yaml"),
    "compare, json over one": ("compare c.yaml dmu50.calibration.yaml --json c.yaml", "c.yaml"),
    "compare, json over the machine": ("compare c.yaml c.yaml -m dmu50.yaml --json dmu50.yaml", "dmu50.yaml"),
    "control, json over the calibration beside kinematics": (
        "control --kinematics siemens-chain -o new -c c.yaml --json c.yaml",
        "c.yaml",
    ),
    "control, json over the calibration": ("control --to siemens -o new -c c.yaml --json c.yaml", "c.yaml"),
    "control, json over a table it reads": (
        "control --read tables/cec.mpf --format siemens --json tables/cec.mpf",
        "tables/cec.mpf",
    ),
    "scene, json over the machine": ("scene p.nc -o o.html -m dmu50.yaml --json dmu50.yaml", "dmu50.yaml"),
    "report, json over the URDF": ("report -o o.html -m dmu50.yaml --json dmu50.urdf", "dmu50.urdf"),
    "simulate over the plan": ("simulate plan.csv -o plan.csv", "plan.csv"),
    "simulate, json over the machine": ("simulate plan.csv -o o.csv -m dmu50.yaml --json dmu50.yaml", "dmu50.yaml"),
    "convert over the contacts": ("convert contacts.csv -o contacts.csv", "contacts.csv"),
    "convert, json over the contacts": ("convert contacts.csv -o o.csv --json contacts.csv", "contacts.csv"),
    "convert over the plan": ("convert contacts.csv -o plan.csv --plan plan.csv", "plan.csv"),
    "import over the table": ("import shop.csv -o shop.csv", "shop.csv"),
    "import over the plan": ("import shop.csv -o plan.csv --plan plan.csv", "plan.csv"),
    "import over the mapping": ("import shop.csv -o o.csv --columns columns.yaml --json columns.yaml", "columns.yaml"),
    "plan, json over the machine": ("plan -o o.csv -m dmu50.yaml --json dmu50.yaml --minutes 60", "dmu50.yaml"),
    "plan over what was measured": (
        'plan -o plan.csv --separate "reversal X" "reversal Y" --after plan.csv',
        "plan.csv",
    ),
    "plan, json over the plan judged": ("plan --judge plan.csv --json plan.csv", "plan.csv"),
    "plan, program over a program that is an input": (
        "plan --instrument probe -o o.csv --kit p.nc --program p.nc",
        "p.nc",
    ),
    "volume, json over the machine": ("volume -m dmu50.yaml --json dmu50.yaml", "dmu50.yaml"),
    "info, json over the URDF": ("info -m dmu50.yaml --json dmu50.urdf", "dmu50.urdf"),
    "axis-run, json over the machine": (
        "axis-run plan.csv --layout nine_beams_x.yaml -o o.yaml -m dmu50.yaml --json dmu50.yaml",
        "dmu50.yaml",
    ),
    "simulate-run, json over the calibration": (
        "simulate-run --layout nine_beams_x.yaml --positions 0,500,5 -o o.csv -c c.yaml --json c.yaml",
        "c.yaml",
    ),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_an_input_is_never_an_output(
    inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    line, file = COMMANDS[name]
    folder = tmp_path / "shop"
    shutil.copytree(inputs, folder)
    (folder / "link.nc").symlink_to("p.nc")
    os.link(folder / "p.nc", folder / "hard.nc")
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    monkeypatch.chdir(folder)
    said = refused(capsys, *shlex.split(line))
    assert "output file is also an input" in said
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before, "and nothing is left"
    assert Path(said.split(":")[1].strip()).samefile(file)


def test_every_path_of_every_command_is_known() -> None:
    """A path that a command writes is marked; every other path is an input and must not be an output."""
    written = {
        "json_file",
        "keep",
        "output",
        "urdf",
        "report_file",
        "html_file",
        "dcc_file",
        "pdf_file",
        "extended",
        "program_file",
        "predicted",
        "scene_file",
    }
    for command in map(commands.load, commands.COMMANDS):
        function: Callable[..., Any] = command.callback.__wrapped__
        marked = {name for name, mark in path_parameters(function).items() if mark is not None}
        named = set(get_type_hints(function)) & written
        assert marked == named, command.name
        assert "json_file" in marked, "every command takes --json"


def test_a_device_or_a_pipe_is_not_replaced(inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pipe = tmp_path / "pipe.json"
    os.mkfifo(pipe)
    for path in (pipe, Path(os.devnull)):
        assert "a regular file" in refused(capsys, "info", "--json", path)
        with pytest.raises(InputError, match="a regular file"):
            write_atomic(path, "lost")
    assert stat.S_ISFIFO(pipe.stat().st_mode) and stat.S_ISCHR(Path(os.devnull).stat().st_mode)


def test_a_read_only_file_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """This also applies to the superuser, who may write any file."""
    out = tmp_path / "kept.json"
    out.write_text("kept")
    out.chmod(0o444)
    assert "not read-only" in refused(capsys, "doc", "--json", out)
    assert out.read_text() == "kept" and stat.S_IMODE(out.stat().st_mode) == 0o444


def test_mode_and_link_stay(tmp_path: Path) -> None:
    file, link = tmp_path / "file.json", tmp_path / "link.json"
    file.write_text("old")
    file.chmod(0o600)
    link.symlink_to(file.name)
    write_atomic(link, "new")
    assert link.is_symlink() and file.read_text() == "new"
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    before = os.umask(0o027)
    try:
        write_atomic(tmp_path / "fresh", "new")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "fresh").stat().st_mode) == 0o640


def test_outputs_may_be_read_and_inputs_may_not_be_written(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    one.write_text("input")
    with tracked_files():
        write_atomic(other, "output")
        assert read_bytes(other) == b"output"
        write_atomic(other, "output again")
        read_bytes(one)
        with pytest.raises(InputError, match="output file is also an input"), atomic_file(one) as stream:
            stream.write(b"lost")
    assert one.read_text() == "input"
    write_atomic(one, "outside of a command it may")


def test_files_of_a_killed_run_are_removed(tmp_path: Path) -> None:
    gone = subprocess.Popen(["true"])
    gone.wait()
    stale = tmp_path / f"{TEMPORARY_PREFIX}{gone.pid}-00ff-{platform.node()}"
    elsewhere = tmp_path / f"{TEMPORARY_PREFIX}{gone.pid}-00ff-another-computer"
    running = tmp_path / f"{TEMPORARY_PREFIX}{os.getppid()}-00ff-{platform.node()}"
    other = tmp_path / f"{TEMPORARY_PREFIX}notes"
    for path in (stale, elsewhere, running, other):
        path.write_text("half")
    with pytest.raises(SystemExit):
        cli.main(["doc", "--json", str(tmp_path / "doc.json")])
    assert {path.name for path in tmp_path.iterdir()} == {"doc.json", elsewhere.name, running.name, other.name}


LONG = PART + "G1 X110 F500\nX100\n" * 300_000


def _children(pid: int) -> list[int]:
    """Return all descendants of a process, from /proc."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                parents[int(entry.name)] = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            except OSError:
                continue
    found, new = [], [pid]
    while new:
        new = [one for one, parent in parents.items() if parent in new]
        found += new
    return found


def _ended(pids: list[int], seconds: float) -> bool:
    limit = time.monotonic() + seconds
    while time.monotonic() < limit:
        alive = [pid for pid in pids if Path(f"/proc/{pid}/stat").exists() and _state(pid) != "Z"]
        if not alive:
            return True
        time.sleep(0.05)
    return False


def _state(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return "Z"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc to see child processes")
@pytest.mark.parametrize(
    "number",
    [signal.SIGTERM, *(pytest.param(number, marks=pytest.mark.slow) for number in (signal.SIGHUP, signal.SIGKILL))],
)
def test_a_signal_leaves_no_file_and_no_process(tmp_path: Path, number: signal.Signals) -> None:
    for name in ("a.nc", "b.nc"):
        (tmp_path / name).write_text(LONG)
    words = ["compensate", tmp_path / "a.nc", tmp_path / "b.nc", "-o", tmp_path / "out", "--workers", 2]
    process = subprocess.Popen([*TWIN, *map(str, words)], stderr=subprocess.PIPE, text=True)
    while process.poll() is None and not any(path.stat().st_size for path in tmp_path.glob("out/.twin-*/*")):
        time.sleep(0.01)
    workers = _children(process.pid)
    assert len(workers) >= 2, "the workers are at work"
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert _ended(workers, 20.0), "no process outlives the command"
    if number is signal.SIGKILL:
        assert process.returncode == -number
        again = [*TWIN, "doc", "--json", str(tmp_path / "out" / "doc.json")]
        assert subprocess.run(again, capture_output=True, check=False).returncode == 0
        assert [path.name for path in (tmp_path / "out").iterdir()] == ["doc.json"]
    else:
        assert process.returncode == 128 + number
        assert f"ended by {number.name}, nothing half written" in errors
        assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("sh") is None, reason="needs a shell")
@pytest.mark.parametrize("number", [pytest.param(signal.SIGHUP, marks=pytest.mark.slow), signal.SIGKILL])
def test_a_compiler_does_not_outlive_the_command(tmp_path: Path, number: signal.Signals) -> None:
    """Use a slow compiler with a child process and a temporary file, like g++."""
    slow, temporary, home = tmp_path / "slow", tmp_path / "tmp", tmp_path / "home"
    temporary.mkdir()
    slow.write_text(
        '#!/bin/sh\ncase "$1" in --version) echo slow 1.0; exit;; esac\n'
        f'echo half > "$TMPDIR/cc1.s"\nsleep 600 &\necho $$ $! > "{tmp_path}/pids"\nwait\n'
    )
    slow.chmod(0o700)
    process = subprocess.Popen(
        [sys.executable, "-m", "twin.cli", "doctor"],
        env={**os.environ, "CXX": str(slow), "TMPDIR": str(temporary), "XDG_CACHE_HOME": str(home)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    pids = tmp_path / "pids"
    while process.poll() is None and not (pids.exists() and pids.read_text().endswith("\n")):
        time.sleep(0.01)
    process.send_signal(number)
    process.wait(60)
    assert _ended([int(pid) for pid in pids.read_text().split()], 10.0)
    left = [path for path in (*temporary.rglob("*"), *home.rglob("*")) if path.suffix == ".s"]
    if number is not signal.SIGKILL:
        assert not left
    else:  # the next run removes them, with the folder of the killed one
        subprocess.run([*TWIN, "doctor"], env={**os.environ, "TMPDIR": str(temporary), "XDG_CACHE_HOME": str(home)},
                       capture_output=True, check=False)  # fmt: skip
        assert not [path for path in (*temporary.rglob("*"), *home.rglob("*")) if path.suffix == ".s"]


@pytest.mark.slow
def test_an_ignored_hangup_stays_ignored(tmp_path: Path) -> None:
    """A hangup is ignored as under nohup."""
    part, out = tmp_path / "part.nc", tmp_path / "out.nc"
    part.write_text(PART + "G1 X110 F500\nX100\n" * 200_000)
    process = subprocess.Popen(
        [*TWIN, "compensate", str(part), "-o", str(out)],
        stdout=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )
    while process.poll() is None and not any(path.stat().st_size for path in tmp_path.glob(".twin-*")):
        time.sleep(0.01)
    process.send_signal(signal.SIGHUP)
    assert process.wait(120) == 0 and out.exists()


def test_json_has_no_number_that_is_not_finite(tmp_path: Path) -> None:
    from twin._common.files import write_json

    write_json(tmp_path / "r.json", {"a": float("nan"), "b": [1.0, float("-inf")], "c": (2,)})
    assert json.loads((tmp_path / "r.json").read_text()) == {"a": None, "b": [1.0, None], "c": [2]}


def test_outputs_of_two_runs_do_not_mix(tmp_path: Path) -> None:
    """Two commands write the same two files; one is interrupted between them, and the other one waits until both are there."""
    first, second = tmp_path / "m.yaml", tmp_path / "m.json"
    between, steps = threading.Event(), []

    def run(name: str, after_one: Callable[[], object]) -> None:
        with tracked_files():
            check_writable([first, second])
            write_atomic(first, name)
            after_one()
            write_atomic(second, name)
            steps.append(name)

    def slow() -> None:
        run("A", lambda: (between.set(), time.sleep(0.5)))

    other = threading.Thread(target=lambda: (between.wait(), run("B", lambda: None)))
    thread = threading.Thread(target=slow)
    other.start(), thread.start()
    other.join(), thread.join()
    assert steps == ["A", "B"] and first.read_text() == second.read_text() == "B"


def test_what_would_not_be_read_back_is_not_written(tmp_path: Path) -> None:
    """The old file stays, no temporary file remains, and the message names the file and the value."""
    dmu50 = twin.Machine.load("dmu50")
    path = tmp_path / "c.yaml"
    twin.Calibration.zero(dmu50).save(path)
    before = path.read_bytes()
    for wrong in (
        replace(twin.Calibration.zero(dmu50), squareness={"E_C0Y": 1e9}),
        replace(twin.Calibration.zero(dmu50), location={"E_X0C": float("nan")}),
    ):
        with pytest.raises(InputError, match="would not be read back") as caught:
            wrong.save(path)
        assert caught.value.file == str(path)
    assert path.read_bytes() == before and [*tmp_path.iterdir()] == [path]
