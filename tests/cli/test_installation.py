"""Tests of the installation: stated requirements hold, and a broken package is named in one line."""

from __future__ import annotations

import inspect
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import yaml

import twin
from tests.cli.commands import TWIN
from twin.cli.shared import installation

ROOT = Path(__file__).parents[2]
REASON = "libbroken.so.4: cannot open shared object file"


def run_with(folder: Path, broken: str, text: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a command with a package of the given name, whose import runs ``text``, first on the path."""
    package = folder / "site" / broken
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(text)
    path = os.pathsep.join([str(ROOT), str(package.parent)])
    return subprocess.run(
        [*TWIN, *words], env={**os.environ, "PYTHONPATH": path}, cwd=folder, capture_output=True, text=True, timeout=300
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "package"),
    [
        ("pinocchio", "pin"),
        pytest.param("scipy", "scipy", marks=pytest.mark.slow),
        pytest.param("casadi", "casadi", marks=pytest.mark.slow),
        pytest.param("yaml", "pyyaml", marks=pytest.mark.slow),
    ],
)
def test_doctor_reports_a_package_that_cannot_be_imported(tmp_path: Path, module: str, package: str) -> None:
    ended = run_with(tmp_path, module, f"raise ImportError({REASON!r})", "doctor")
    assert ended.returncode == 3 and ended.stderr == ""
    (line,) = [line for line in ended.stdout.splitlines() if line.startswith(f"FAILED  {package} ")]
    assert line.endswith(f"cannot be imported: ImportError: {REASON}")
    assert re.search(rf"FAILED: {package}\b", ended.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("module", ["meshcat", pytest.param("matplotlib", marks=pytest.mark.slow)])
def test_doctor_checks_the_machine_if_only_pictures_are_broken(tmp_path: Path, module: str) -> None:
    ended = run_with(tmp_path, module, f"raise ImportError({REASON!r})", "doctor", "--json", "doctor.json")
    assert ended.returncode == 3 and ended.stderr == ""
    assert f"FAILED: {module}" in ended.stdout and "least squares" in ended.stdout
    assert REASON in (tmp_path / "doctor.json").read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "the process ended with status -11"),
        pytest.param("raise RuntimeError('built for another\\nprocessor')", "processor", marks=pytest.mark.slow),
    ],
)
def test_doctor_survives_an_import_that_ends_the_process(tmp_path: Path, text: str, reason: str) -> None:
    ended = run_with(tmp_path, "casadi", text, "doctor")
    assert ended.returncode == 3 and f"cannot be imported: {reason}\n" in ended.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "package", "words"),
    [
        ("pinocchio", "pin", ["info"]),
        pytest.param("scipy", "scipy", ["compensate", "cone_frustum.nc", "-o", "out.nc"], marks=pytest.mark.slow),
        ("meshcat", "meshcat", ["scene", "cone_frustum.nc", "-o", "out.html", "--tool-length", "120"]),
    ],
)
def test_another_command_names_the_package_in_one_line(
    tmp_path: Path, module: str, package: str, words: list[str]
) -> None:
    ended = run_with(tmp_path, module, f"raise ImportError({REASON!r})", *words)
    assert ended.returncode == 2 and ended.stdout == ""
    assert ended.stderr == (
        f"twin: {package} cannot be imported (ImportError: {REASON}); expected working packages: run twin doctor\n"
    )


@pytest.mark.slow
def test_an_import_error_of_twin_itself_is_not_hidden() -> None:
    defect = ImportError("of twin itself")
    with pytest.raises(ImportError) as caught:
        installation.exit_with_import_error(defect)
    assert caught.value is defect


def test_what_a_public_function_returns_has_a_public_name() -> None:
    assert "Any" not in dir(twin)
    for name in twin.__all__:
        of = getattr(twin, name)
        if inspect.isfunction(of):
            for result in re.findall(r"(?<![.\w])[A-Z]\w+", str(of.__annotations__["return"])):
                foreign = result in ("None", "Generator", "Path", "Axes")
                assert foreign or (result in dir(twin) and inspect.isclass(getattr(twin, result))), (name, result)


@pytest.mark.parametrize("name", twin.__all__)
def test_every_public_name_exists(name: str) -> None:
    assert getattr(twin, name) is not None and name in dir(twin)
    with pytest.raises(ModuleNotFoundError):  # a module of that name would take its place
        import_module(f"twin.{name}")


def test_unknown_name() -> None:
    with pytest.raises(AttributeError, match="'twin' has no attribute 'machine_of'"):
        _ = twin.machine_of


def test_a_path_instead_of_what_was_read_from_it() -> None:
    machine = twin.Machine.load("dmu50")
    with pytest.raises(
        TypeError, match=r"data must be a Measurements, not str; Measurements[.]load reads one from a file"
    ):
        twin.identify("measured.csv", machine)
    with pytest.raises(TypeError, match="data must be a Measurements"):
        twin.diagnose(Path("measured.csv"), machine)
    with pytest.raises(TypeError, match="data must be a Measurements"):
        twin.evaluate("measured.csv", machine)
    with pytest.raises(TypeError, match="first must be a Calibration"):
        twin.compare("old.yaml", "new.yaml")
    with pytest.raises(TypeError, match="machine must be a Machine"):
        twin.Kinematics("dmu50")
    for call in (
        lambda: twin.Measurements.load("measured.csv", "dmu50"),
        lambda: twin.Calibration.default("dmu50"),
        lambda: twin.compensate("cone_frustum.nc", "dmu50"),
        lambda: twin.plan("dmu50"),
    ):
        with pytest.raises(TypeError, match=r"machine must be a Machine, not str; Machine[.]load reads one"):
            call()
    with pytest.raises(TypeError, match=r"calibration must be a Calibration, not PosixPath; Calibration[.]load reads"):
        twin.scene("cone_frustum.nc", machine, Path("mine.yaml"))


def test_what_makes_a_table_of_a_frame_and_an_instrument_of_its_name() -> None:
    machine = twin.Machine.load("dmu50")
    plan = twin.thesis_plan.plan(machine)
    with pytest.raises(TypeError, match=r"not DataFrame; twin[.]measurements_from_frame makes one"):
        twin.diagnose(twin.to_frame(plan, machine), machine)
    for call in (
        lambda: twin.diagnose(plan, machine, instrument="tracker"),
        lambda: twin.identify(plan, machine, instrument="tracker"),
        lambda: twin.simulate(plan, machine, twin.Calibration.zero(machine), "tracker", np.random.default_rng(1)),
    ):
        with pytest.raises(TypeError, match=r"not str; twin[.]instruments[.]instrument_named gives one by its name"):
            call()


@pytest.mark.parametrize("code", ["import twin", "from twin.cli import main; main(['--help'])"], ids=["import", "help"])
def test_neither_import_nor_help_loads_a_package_that_calculates(code: str) -> None:
    """`twin --help` takes 0.2 s of processor time; with numpy and scipy it took 1.2 s."""
    heavy = "{'numpy', 'pinocchio', 'casadi', 'scipy', 'yaml', 'jinja2', 'pydantic'}"
    code = f"import atexit, sys; atexit.register(lambda: print(sorted({heavy} & set(sys.modules)))); {code}"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=100, check=True)
    assert ended.stdout.splitlines()[-1] == "[]"


# ---- lower bounds


def lower_bounds() -> dict[str, str]:
    """Lower bound of every package that an installation of twin takes, by name."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    found = {}
    for entry in (*project["dependencies"], *extras["plots"], *extras["cluster"]):
        name, bound = re.fullmatch(r"([a-z0-9-]+)>=([0-9.]+)", entry).groups()  # type: ignore[union-attr]
        found[name] = bound
    return found


def test_the_oldest_packages_are_those_of_the_lower_bounds() -> None:
    """`.ci/run` tests with the oldest packages, which must be those of the lower bounds."""
    lines = [line for line in (ROOT / ".ci" / "oldest.txt").read_text().splitlines() if not line.startswith("#")]
    pins = dict(line.split("==") for line in lines)
    assert len(pins) == len(lines)
    assert pins == lower_bounds()


def test_doctor_checks_every_package() -> None:
    assert {*installation.NEEDED, *installation.OPTIONAL} == set(lower_bounds())


def test_the_citation_is_of_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert citation["version"] == project["version"] and citation["title"].endswith(
        project["description"].lower()[2:-1]
    )


@pytest.mark.slow
def test_wheel_and_sdist_hold_the_package_and_the_wheel_runs(tmp_path: Path) -> None:
    """Both are built by the stated backend; the sdist builds the same wheel; the wheel alone answers a command."""
    requires = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv" / "bin" / "python"

    def run(*words: object, cwd: Path = tmp_path, **environment: str) -> str:
        words_of_text = [str(word) for word in words]
        ended = subprocess.run(
            words_of_text, cwd=cwd, env={**os.environ, **environment}, capture_output=True, text=True, timeout=500
        )
        assert ended.returncode == 0, (words_of_text, ended.stderr)
        return ended.stdout

    run(python, "-m", "pip", "install", "--quiet", *requires)
    run(python, "-m", "hatchling", "build", "-d", tmp_path / "dist", cwd=ROOT)
    (wheel,), (source,) = ([*(tmp_path / "dist").glob(kind)] for kind in ("*.whl", "*.tar.gz"))
    tracked = run("git", "ls-files", "twin", "urdf", cwd=ROOT).splitlines()
    expected = {f"twin/{name}" if name.startswith("urdf/") else name for name in tracked}
    held = set(zipfile.ZipFile(wheel).namelist())
    assert expected <= held and all(name in expected or ".dist-info/" in name for name in held)
    with tarfile.open(source) as archive:
        archive.extractall(tmp_path / "source", filter="data")
    (unpacked,) = (tmp_path / "source").iterdir()
    run(python, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path / "again", cwd=unpacked)
    (again,) = (tmp_path / "again").glob("*.whl")
    assert set(zipfile.ZipFile(again).namelist()) == held
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "installed")
    code = "import twin; from twin.cli import main; print(twin.__file__, flush=True); main(['info'])"
    printed = run(sys.executable, "-c", code, PYTHONPATH=str(tmp_path / "installed"))
    assert printed.startswith(str(tmp_path / "installed" / "twin")) and "DMU 50" in printed
