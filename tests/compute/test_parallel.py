"""Several processes and a real Dask cluster: the same bits as in one process even if workers die; errors found before the work."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from distributed import Client

from tests.compute import chores
from tests.diagnosis import battery, rivals
from tests.model.errors import random_calibration
from tests.tool.test_population import draws_of
from tests.tool.test_uncertainty import with_covariance
from twin import cli
from twin._common.errors import InputError
from twin.compute import parallel as processes
from twin.compute.parallel import Workers, map_as_completed, map_in_order
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.tool.forward import Kinematics
from twin.tool.population import draw_machines

ROOT = Path(__file__).resolve().parents[2]
HERE = Workers(1)
DASK = [sys.executable, "-m", "dask"]
PROGRAM = "G21 G90\nG0 X100 Y100 Z-100 B30 C10\nG1 X120 F500\nY150 C20\nM30\n"


def until(what: object, seconds: float = 60.0) -> None:
    """Wait for a condition to become true."""
    end = time.monotonic() + seconds
    while not what():  # type: ignore[operator]
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.05)


def worker(address: str, room: Path, path: Path, *options: str) -> subprocess.Popen[bytes]:
    """Start a Dask worker process with a folder on its path."""
    command = [*DASK, "worker", address, "--nthreads", "1", "--no-dashboard", "--local-directory", str(room), *options]
    return subprocess.Popen(
        command,
        env=os.environ | {"PYTHONPATH": str(path)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=room,
    )


@contextmanager
def cluster(room: Path, workers: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Start a scheduler and workers, each a process as on another computer; yield its address and the processes to stop."""
    file = room / "scheduler.json"
    command = [*DASK, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    processes = [
        subprocess.Popen(
            [*command, "--scheduler-file", str(file)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=room
        )
    ]
    try:
        until(lambda: file.exists() and file.stat().st_size > 0)
        address = json.loads(file.read_text())["address"]
        processes.append(worker(address, room, ROOT, "--nworkers", str(workers)))
        with Client(address) as client:
            client.wait_for_workers(workers, timeout=60)
        yield address, processes
    finally:
        for process in reversed(processes):  # workers first, since they unregister with the scheduler
            process.terminate()
            process.wait(30)


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with cluster(tmp_path_factory.mktemp("cluster"), 2) as (address, _):
        yield address


@pytest.fixture(params=["copies", "new", "dask"])
def others(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Workers:
    """Return workers in other processes: copies of this one (on Linux), new ones, and those of a cluster."""
    if request.param == "dask":
        return Workers(scheduler=request.getfixturevalue("scheduler"))
    monkeypatch.setattr(processes, "only_idle_threads", lambda: request.param == "copies")
    return Workers(2)


@pytest.fixture(scope="module")
def uncertain(dmu50: Machine) -> Calibration:
    rng = np.random.default_rng(20)
    return with_covariance(random_calibration(dmu50, rng, 100.0), rng, 2.0)


@pytest.mark.sample(1)  # of 3
def test_order_and_names(others: Workers) -> None:
    assert list(map_in_order(chores.squared, 1, range(7), others)) == [1 + i * i for i in range(7)]
    assert sorted(map_as_completed(chores.squared, 1, range(7), others)) == [(i, 1 + i * i) for i in range(7)]
    assert list(map_in_order(chores.squared, 1, [], others)) == []


def test_workers_end_with_the_results(others: Workers, tmp_path: Path) -> None:
    """Leave after the first result: the other workers, which sleep for a minute, are ended."""
    found = map_as_completed(chores.patient, tmp_path, range(4), others)
    assert next(found) == (0, 0)
    until(lambda: len(list(tmp_path.iterdir())) >= 2)
    began = time.monotonic()
    found.close()
    assert time.monotonic() - began < 20.0
    if others.scheduler is None:
        assert not any(alive(int(file.name.split()[1])) for file in tmp_path.iterdir())
    shutil.rmtree(tmp_path)  # what runs on a cluster ends, too


def test_a_copy_needs_a_process_without_other_threads() -> None:
    """Threads of this process that could hold a lock forbid copies of it; idle ones of compiled code do not."""
    alone = "import numpy as np; from twin.compute.native import compiler; compiler.map_parts([slice(0, 1), slice(1, 2)], id)"
    other = "import threading, time; threading.Thread(target=time.sleep, args=(60,), daemon=True).start()"
    for lines, may in ((alone, "True"), (other, "False")):
        source = f"{lines}\nfrom twin.compute.native.compiler import only_idle_threads\nprint(only_idle_threads())"
        done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True)
        assert done.stdout.strip() == may, done.stderr


def test_threads_of_linear_algebra_do_not_show(others: Workers) -> None:
    wanted = list(map_in_order(chores.product, 5, range(4), HERE))
    found = list(map_in_order(chores.product, 5, range(4), others))
    assert all(np.array_equal(a, b) for a, b in zip(wanted, found, strict=True))


def drawn(machine: Machine, calibration: Calibration, workers: Workers) -> str:
    """Return the result of three tasks of drawn machines."""
    kinematics = Kinematics(machine, calibration, tool_length_mm=120.0)
    return json.dumps(draw_machines(kinematics, trials=40_000, poses=12, seed=3, workers=workers).to_dict())


@pytest.fixture(scope="module")
def drawn_here(dmu50: Machine, uncertain: Calibration) -> str:
    return drawn(dmu50, uncertain, HERE)


def test_a_volume_is_the_same_to_the_last_bit(
    dmu50: Machine, uncertain: Calibration, drawn_here: str, others: Workers
) -> None:
    assert drawn(dmu50, uncertain, others) == drawn_here


def answered(workers: Workers) -> list[battery.Answer]:
    """Return the answers for two data sets."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(battery, "FRESH", 2)
        found = battery.answers("one60", 3, 33, poses=30, workers=workers)
    return [replace(one, seconds=0.0) for one in found]


@pytest.fixture(scope="module")
def answered_here() -> list[battery.Answer]:
    return answered(HERE)


@pytest.mark.slow
def test_a_battery_is_the_same(answered_here: list[battery.Answer], others: Workers) -> None:
    assert answered(others) == answered_here


@pytest.mark.slow
def test_the_volume_of_another_process_with_other_threads(
    uncertain: Calibration, dmu50: Machine, tmp_path: Path
) -> None:
    """Run the command on a file in a process whose linear algebra starts with two threads; here it has one (conftest.py)."""
    uncertain.save(tmp_path / "c.yaml")
    loaded = Kinematics(dmu50, Calibration.load(tmp_path / "c.yaml", dmu50))
    wanted = draw_machines(loaded, trials=1000, poses=5, seed=3, workers=HERE).to_dict()
    command = [sys.executable, "-m", "twin.cli", "volume", "-c", "c.yaml", "--trials", "1000", "--poses", "5"]
    done = subprocess.run(
        [*command, "--seed", "3", "--json", "v.json"],
        cwd=tmp_path,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "v.json").read_text()) == wanted


@pytest.mark.slow
def test_its_rivals_are_the_same(monkeypatch: pytest.MonkeyPatch, others: Workers) -> None:
    monkeypatch.setattr(battery, "FRESH", 2)
    wanted = rivals.compared("one60", 3, 33, poses=30)
    found = rivals.compared("one60", 3, 33, poses=30, workers=others)
    for method, said in wanted.items():
        assert [replace(one, seconds=0.0) for one in found[method]] == [replace(one, seconds=0.0) for one in said]


def ended(*arguments: object) -> int:
    """Return the exit status of a command."""
    with pytest.raises(SystemExit) as stopped:
        cli.main([str(argument) for argument in arguments])
    return int(stopped.value.code or 0)


def options(workers: Workers) -> list[str]:
    return ["--workers", str(workers.processes)] if workers.scheduler is None else ["--scheduler", workers.scheduler]


@pytest.fixture
def parts(tmp_path: Path) -> dict[str, str]:
    """Return programs to process: one that leaves the range, one that cannot be read, one that does not exist."""
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "a.nc").write_text(PROGRAM)
    (folder / "b.h").write_text(
        "0 BEGIN PGM B MM\n1 L X+100 Y+100 Z-100 B+30 C+10 FMAX\n2 L X+120 F500\n3 END PGM B MM\n"
    )
    (folder / "far.nc").write_text("G90\nG0 X100 Y100 Z-100 B30 C10\nG1 X700 F500\n")
    (folder / "bad.nc").write_text("G90\nG0 X100 Y\n")
    return {name: str(folder / name) for name in ("a.nc", "b.h", "far.nc", "bad.nc", "none.nc")}


@pytest.mark.sample(1)  # of 3
def test_programs_are_the_same_and_a_bad_one_stops_none(
    parts: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str], others: Workers
) -> None:
    for name in ("a.nc", "b.h"):
        assert ended("compensate", parts[name], "-o", tmp_path / name) == 0
    capsys.readouterr()
    out, total = tmp_path / "out", tmp_path / "total.json"
    assert ended("compensate", *parts.values(), "-o", out, "--json", total, *options(others)) == 2
    printed = capsys.readouterr()
    assert (out / "a.nc").read_bytes() == (tmp_path / "a.nc").read_bytes()
    assert (out / "b.h").read_bytes() == (tmp_path / "b.h").read_bytes()
    kept = ["a.nc", "b.h", "far.nc"]
    wanted = sorted(name + ending for name in kept for ending in ("", ".report.json", ".report.txt"))
    assert sorted(path.name for path in out.iterdir()) == wanted
    assert "(line 3): outside the range of X" in (out / "far.nc.report.txt").read_text()
    assert json.loads((out / "a.nc.report.json").read_text())["program"] == parts["a.nc"]
    # The error names the user's own file, wherever it was read.
    assert f"twin: {parts['bad.nc']}:2:" in printed.err and parts["none.nc"] in printed.err
    assert printed.err.count("\n") == 2
    assert "5 programs: 2 done, 1 done in part, 2 failed" in printed.out
    data = json.loads(total.read_text())
    verdicts = {Path(one["program"]).name: one["verdict"] for one in data["programs"]}
    assert verdicts == {"a.nc": "done", "b.h": "done", "far.nc": "not met", "bad.nc": "failed", "none.nc": "failed"}
    assert data["exit_status"] == 2


def test_exit_status_of_several(parts: dict[str, str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    assert ended("compensate", parts["a.nc"], parts["b.h"], "-o", out, "--workers", 1) == 0
    assert ended("compensate", parts["a.nc"], parts["far.nc"], "-o", out, "--workers", 1) == 3
    assert ended("compensate", parts["a.nc"], "-o", out) == 0  # a single program, into an existing folder
    assert ended("compensate", parts["bad.nc"], parts["none.nc"], "-o", tmp_path / "new", "--workers", 1) == 2
    assert not (tmp_path / "new").exists()


def test_several_that_cannot_go_into_that_folder(
    parts: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "other").mkdir()
    shutil.copy(parts["a.nc"], tmp_path / "other" / "a.nc")
    for arguments, word in (
        ([parts["a.nc"], parts["b.h"], "-o", tmp_path / "in"], "overwrite the program"),
        ([parts["a.nc"], tmp_path / "other" / "a.nc", "-o", tmp_path / "out"], "same file name"),
        ([parts["a.nc"], parts["b.h"], "-o", parts["far.nc"]], "a folder"),
        ([parts["a.nc"], parts["b.h"], "-o", tmp_path / "out.nc"], "a folder"),
        ([parts["a.nc"], "-o", tmp_path / "out.nc", "--scheduler", "tcp://127.0.0.1:1"], "several"),
        ([parts["a.nc"], parts["b.h"], "-o", tmp_path / "no" / "out"], "existing folder"),
        ([parts["a.nc"], parts["b.h"], "-o", tmp_path / "out", "--workers", 0], "at least 1"),
    ):
        before = sorted(path.name for path in tmp_path.rglob("*"))
        assert ended("compensate", *arguments) == 2
        message = capsys.readouterr().err
        assert word in message and message.count("\n") == 1, message
        assert sorted(path.name for path in tmp_path.rglob("*")) == before


@pytest.mark.sample(1)  # of 3
def test_a_worker_that_is_killed_loses_nothing(
    dmu50: Machine, uncertain: Calibration, tmp_path: Path, others: Workers
) -> None:
    """Kill a worker by its id during a Monte Carlo run; all machines are drawn, with the same result."""
    draws = draws_of(dmu50, uncertain, poses=12).pilot()
    tasks = [(i, 2000) for i in range(6)]
    wanted = [draws.part(task) for task in tasks]
    mark = tmp_path / "mark"
    found = list(map_in_order(chores.drawn_and_once_dead, (draws, mark), tasks, others))
    assert mark.exists()
    assert [one.machines for one in found] == [2000] * 6
    for a, b in zip(wanted, found, strict=True):
        assert np.array_equal(a.point, b.point) and np.array_equal(a.totals, b.totals)


def test_a_refusal_arrives_as_it_was_raised(others: Workers) -> None:
    with pytest.raises(InputError, match=r"numbers.csv:7: no such number: '3'; expected another"):
        list(map_in_order(chores.refusing, 3, range(8), others))


def test_a_task_that_kills_its_workers_is_named(monkeypatch: pytest.MonkeyPatch, others: Workers) -> None:
    """All other tasks are completed, without endless waiting. Two deaths suffice: one among others, one alone."""
    monkeypatch.setattr(processes, "MAX_DEATHS", 2)
    found = dict(
        map_as_completed(
            chores.deadly, 3, range(4), others, name=lambda task: f"task number {task}", return_errors=True
        )
    )
    refusal = found.pop(3)
    assert (
        isinstance(refusal, InputError)
        and "while running this task" in str(refusal)
        and "task number 3" in str(refusal)
    )
    assert found == {0: 0, 1: 1, 2: 2}


def test_no_scheduler_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "CONNECT_TIMEOUT_S", 1.0)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        for address in ("banana", "tcp://127.0.0.1:1", f"tcp://127.0.0.1:{silent.getsockname()[1]}"):
            with pytest.raises(InputError, match="no Dask scheduler at this address"):
                list(map_in_order(chores.squared, 1, range(3), Workers(scheduler=address)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lost", "words"), [(0, "connection to the scheduler was lost"), (1, "no worker of the cluster")]
)
def test_a_cluster_that_ends_during_the_work(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, lost: int, words: str
) -> None:
    """Neither the loss of the scheduler (process 0) nor that of all workers (process 1) is waited for forever."""
    monkeypatch.setattr(processes, "CHECK_S", 0.5)
    monkeypatch.setattr(processes, "NO_WORKER_TIMEOUT_S", 2.0)
    (tmp_path / "marks").mkdir()
    with cluster(tmp_path, 1) as (address, running):
        found = map_as_completed(chores.patient, tmp_path / "marks", range(1, 3), Workers(scheduler=address))
        stop = threading.Timer(5.0, running[lost].terminate)
        stop.start()
        with pytest.raises(InputError, match=words):
            list(found)
        stop.join()


def test_without_dask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)  # marks the module as not importable
    with pytest.raises(InputError, match=r"twin\[cluster\]"):
        list(map_in_order(chores.squared, 1, range(3), Workers(scheduler="tcp://127.0.0.1:1")))


def _refused_while_there(scheduler: str, folder: Path, *words: str) -> None:
    """Check that a worker started in a folder is rejected with these words, and that work goes on when it is gone."""

    def refused() -> bool:
        try:
            list(map_in_order(chores.squared, 1, range(3), Workers(scheduler=scheduler)))
        except InputError as error:
            assert all(word in str(error) for word in words)
            return True
        return False

    with Client(scheduler) as client:
        here = len(client.nthreads())
        stranger = worker(scheduler, folder, folder)
        # Wait until it has joined: a worker without twin closes if it joins while tasks are distributed.
        client.wait_for_workers(here + 1, timeout=60)
    try:
        assert refused()
    finally:
        stranger.terminate()
        stranger.wait(30)
    until(lambda: not refused())


@pytest.mark.slow
def test_a_worker_with_another_twin_is_refused(scheduler: str, tmp_path: Path) -> None:
    """Another source with the same version could give other digits."""
    shutil.copytree(ROOT / "twin", tmp_path / "twin", ignore=shutil.ignore_patterns("__pycache__"))
    with (tmp_path / "twin" / "units.py").open("a") as stream:
        stream.write("# another\n")
    (tmp_path / "urdf").symlink_to(ROOT / "urdf")
    list(map_in_order(chores.squared, 1, range(3), Workers(scheduler=scheduler)))

    _refused_while_there(scheduler, tmp_path, "other versions", "twin 0")


@pytest.mark.slow
def test_a_worker_without_twin_is_refused(scheduler: str, tmp_path: Path) -> None:
    """As on a computer without twin: neither package nor distribution is found."""
    hidden = """
import importlib.metadata, sys
class Hide:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == "twin":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Hide())
version = importlib.metadata.version
def without(name):
    if name == "twin":
        raise importlib.metadata.PackageNotFoundError(name)
    return version(name)
without.__module__, without.__name__, without.__qualname__ = "importlib.metadata", "version", "version"
importlib.metadata.version = without
"""
    (tmp_path / "sitecustomize.py").write_text(hidden)

    _refused_while_there(scheduler, tmp_path, "twin is not installed on a worker")


@pytest.mark.slow
def test_interrupt_ends_the_workers_and_keeps_what_is_written(tmp_path: Path) -> None:
    """Send Ctrl-C, as a terminal does to all its processes: one program is done, one is not."""
    (tmp_path / "a.nc").write_text(PROGRAM)
    (tmp_path / "long.nc").write_text("G90\nG0 X100 Y100 Z-100 B30 C10\n" + "G1 X110 F500\nX100\n" * 2_000_000)
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", "twin.cli", "compensate", "a.nc", "long.nc", "-o", "out", "--workers", "2"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    until((out / "a.nc").exists)
    os.killpg(process.pid, signal.SIGINT)
    printed, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    # A running compiler is ended, too, and its worker may report that first.
    said = ["twin: 1 of 2 programs written", "twin: interrupted, nothing half written"]
    assert errors.decode().splitlines()[-2:] == said
    assert b"1 done" in printed
    assert sorted(path.name for path in out.iterdir()) == ["a.nc", "a.nc.report.json", "a.nc.report.txt"]
    until(lambda: not alive(-process.pid))


def alive(process: int) -> bool:
    """Return whether a process exists; with a negative number, any of that group."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def test_an_error_goes_through_a_pickle() -> None:
    error = InputError("what", expected="that", file=Path("a.nc"), line=3, value=4.5)
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error)
    assert (again.what, again.expected, again.file, again.line) == ("what", "that", "a.nc", 3)
