"""Every file that another command reads is read back by its own loader before it replaces the output."""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import pytest

from tests.diagnosis.test_hidden_unknown import stage_table
from tests.measurement.formats.cases import CASES as MEASURED
from tests.measurement.importing import shop_files
from tests.standards.shop_floor import FilledSheet, Truth, fill
from tests.thermal import machine_room
from tests.truth.few_axes import write_stage
from twin import cli
from twin._common import files
from twin.cli import commands
from twin.cli.shared.command import path_parameters
from twin.machine.machine import Machine
from twin.standards.artefacts import plan_sheet

REPORT: Final = "no command reads a report"
BACK: Final = "read back"
WRITTEN: Final = {
    ("compensate", "output"): "its words are solved for and checked against the machine block by block",
    ("path", "output"): "its words are executed again and compared with the given path",
    (
        "control",
        "output",
    ): "tables and kinematics are read back from a scratch folder before; the calibration is read back",
    (
        "machine",
        "output",
    ): "machine file and URDF are loaded from a scratch folder and compared with the answers before",
    ("machine", "keep"): "answers of which some may be missing",
    ("scene", "output"): REPORT,
    ("forecast", "output"): REPORT,
    ("forecast", "scene_file"): REPORT,
    ("report", "output"): REPORT,
    ("demo", "output"): "a folder written by other commands",
    ("report", "dcc_file"): "its numbers are read back from the XML before it is written",
    ("evaluate", "dcc_file"): "its numbers are read back from the XML before it is written",
    ("thermal", "predicted"): "a table to draw: no command reads a prediction",
    **{
        (name, "output"): BACK
        for name in "axis-run convert evaluate identify import info plan simulate simulate-run thermal".split()
    },
    ("info", "urdf"): BACK,
    ("diagnose", "extended"): BACK,
    ("thermal", "extended"): BACK,
    ("plan", "program_file"): BACK,
    ("identify", "json_file"): BACK,
}
"""Why an output is, or need not be, read back; reports (`--json`, `--html`, `--pdf`, `--report`) are read by no command."""
REPORTS: Final = {"json_file", "html_file", "pdf_file", "report_file"}
COMMANDS: Final = {
    "simulate": ("simulate plan.csv -o o.csv", {"o.csv"}),
    "identify": ("identify readings.csv -m stage.yaml -o o.yaml --json o.json", {"o.yaml", "o.json"}),
    "diagnose": ("diagnose readings.csv -m stage.yaml --extended o.yaml --json o.json", {"o.yaml"}),
    "simulate-run": ("simulate-run --layout nine_beams_x.yaml --positions 0,500,5 -o o.csv", {"o.csv"}),
    "axis-run": ("axis-run run.csv --layout nine_beams_x.yaml -o o.yaml", {"o.yaml"}),
    "evaluate": ("evaluate sheet.csv -o o.yaml", {"o.yaml"}),
    "import": ("import shop.csv -o o.csv --columns columns.yaml", {"columns.yaml"}),
    "convert": ("convert contacts.csv -o o.csv", {"o.csv"}),
    "info": ("info -c run.yaml -o o.yaml --datum 'end points' --urdf o.urdf", {"o.yaml", "o.urdf"}),
    "control": ("control --to siemens -o o", {"calibration.yaml"}),
    "kinematics": ("control --kinematics siemens-chain -o o --force", {"calibration.yaml"}),
    "thermal": ("thermal record.csv -o o.yaml --predicted o.csv --extended w.yaml", {"o.yaml", "w.yaml"}),
    "plan": ("plan --instrument probe -o o.csv --program o.ngc --minutes 20", {"o.csv", "o.ngc"}),
}
"""A call of each command that writes a file for another one, and the files to be read back."""


def test_every_output_of_every_command_is_read_back_or_has_a_reason() -> None:
    found = set()
    for command in map(commands.load, commands.COMMANDS):
        function: Callable[..., Any] = command.callback.__wrapped__
        found |= {(command.name, name) for name, mark in path_parameters(function).items() if mark is not None}
    assert {one for one in found if one in WRITTEN or one[1] not in REPORTS} == set(WRITTEN)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    plan = Path(cli.__file__).parents[1] / "samples" / "thesis_plan.csv"
    (folder / "plan.csv").write_text("".join(plan.read_text().splitlines(keepends=True)[:40]))
    write_stage(folder)
    positions = np.linspace(0.0, 500.0, 11)
    stage_table(folder / "readings.csv", positions, 20.0 * ((positions - 250.0) / 250.0) ** 2, 0.0, 0.6)
    (folder / "contacts.csv").write_text(MEASURED["contacts"].GOOD)
    (folder / "shop.csv").write_bytes(shop_files.cmm_report())
    sheet, _ = plan_sheet(Machine.load("dmu50"), "diagonals", "XY", (400.0, 300.0))
    (folder / "sheet.csv").write_text(fill(FilledSheet(sheet), Truth(), np.random.default_rng(1), 0.05))
    machine_room.write(machine_room.simulate(1, hours=3.0), folder / "record.csv")
    layout = "--layout nine_beams_x.yaml"
    for line in (
        f"simulate-run {layout} --positions 0,500,11 -o {folder}/run.csv",
        f"axis-run {folder}/run.csv {layout} -o {folder}/run.yaml",
    ):
        run(line)
    return folder


def run(line: str) -> int:
    with pytest.raises(SystemExit) as ended:
        cli.main(shlex.split(line))
    return int(ended.value.code or 0)


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=pytest.mark.slow if one in ("plan", "thermal") else ()) for one in COMMANDS]
)
def test_what_another_command_reads_is_read_back(
    name: str, inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    line, expected = COMMANDS[name]
    folder = tmp_path / "shop"
    shutil.copytree(inputs, folder)
    monkeypatch.chdir(folder)
    plain, checked = files.atomic_file, set()

    @contextmanager
    def spy(path: Path, check: Callable[[Path], object] | None = None) -> Iterator[BinaryIO]:
        if check is not None:
            checked.add(Path(path).name)
        with plain(path, check) as stream:
            yield stream

    monkeypatch.setattr(files, "atomic_file", spy)
    assert run(line) in (0, 2 if name == "import" else 3)  # 2: a mapping to confirm
    assert expected <= checked
    assert all(any(folder.rglob(one)) for one in expected)
