"""Tests of the pure parts of the benchmark of peers: the table, packages that are missing, and the serial chain."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks import __main__ as benchmarks
from tests.benchmarks.peers import table
from tests.benchmarks.peers.chain import pinocchio_model, serial_chain
from tests.benchmarks.peers.record import Measured, Peer, Row, Section, row, section
from tests.benchmarks.peers.selection import result
from tests.benchmarks.timing import Timing
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.tool.forward import Kinematics

OURS = Timing(np.array([2.0, 4.0]), 1.0)
OTHER = Measured(Timing(np.array([10.0, 12.0]), 1.0), 1_000, "residual at most 1e-09 mm")
MISSING = "no-such-package-of-twin"


def never() -> Measured:
    raise AssertionError("a peer that is not installed must not be measured")


def test_a_missing_peer_is_reported_and_not_measured() -> None:
    found = row(Peer(("numpy", MISSING), "inverts", never), OURS)
    assert found == Row(MISSING, "inverts")
    assert found.text() == f"  {MISSING}: not installed"


def test_an_installed_peer_has_version_and_ratios() -> None:
    found = row(Peer(("numpy",), "inverts", lambda: OTHER), OURS)
    assert found.version == np.__version__
    assert found.ratio == (5.0, 2.5, 6.0)
    assert (
        found.text()
        == f"  numpy {np.__version__}: 5 (2.5 to 6) times ours, 1,000 points. inverts. residual at most 1e-09 mm"
    )


def test_an_error_of_an_installed_peer_is_not_hidden() -> None:
    with pytest.raises(AssertionError, match="must not be measured"):
        row(Peer(("numpy",), "inverts", never), OURS)


def test_a_section_prints_every_line(capsys: pytest.CaptureFixture[str]) -> None:
    peers = [Peer((MISSING,), "inverts", never), Peer(("numpy",), "inverts", lambda: OTHER)]
    found = section("Inverse", "`solve`", Measured(OURS, 10, "exact"), peers)
    assert found.ours == "`solve`: 2 µs per point (10 points); exact"
    lines = capsys.readouterr().out.splitlines()
    assert lines == ["Inverse", f"  twin: {found.ours}", *(one.text() for one in found.rows)]


def test_the_page_has_a_table_row_for_every_peer() -> None:
    rows = (
        Row("missing", "inverts"),
        Row("present", "a|b", "1.2", 1_000, (1234.0, 0.5, 2345.0), "residual at most 1e-09 mm"),
    )
    text = table.page([Section("Inverse", "`solve`: 2 µs", rows)], "a computer", datetime.date(2026, 3, 9))
    assert f"Made by `{table.COMMAND}` on 2026-03-09: a computer; Python 3." in text
    assert "\n## Inverse\n\nRatio 1 is `solve`: 2 µs.\n" in text
    assert text.splitlines()[-2:] == [
        "| missing | not installed | inverts |  |  |  |",
        r"| present | 1.2 | a\|b | 1,000 | 1,234 (0.5 to 2,345) | residual at most 1e-09 mm |",
    ]


def test_the_page_in_the_documentation_was_made_by_this_writer() -> None:
    text = table.PAGE.read_text(encoding="utf-8")
    assert text.startswith(f"{table.INTRODUCTION}Made by `{table.COMMAND}` on ")
    assert f"| {' | '.join(table.HEADERS)} |\n" in text
    assert f": {table.PAGE.name}\n" in (table.PAGE.parents[1] / "mkdocs.yml").read_text(encoding="utf-8")


def test_only_the_benchmark_of_peers_writes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    one = Section("Inverse", "`solve`: 2 µs", (Row("missing", "inverts"),))
    monkeypatch.setattr(benchmarks.peers, "sections", lambda machine: [one])
    monkeypatch.setattr(benchmarks.peers, "PAGE", tmp_path / "peers.md")
    assert benchmarks.main(["peers"]) == 0
    assert not (tmp_path / "peers.md").exists()
    assert benchmarks.main(["peers", "--write"]) == 0
    assert "| missing | not installed |" in (tmp_path / "peers.md").read_text(encoding="utf-8")
    assert benchmarks.main(["solve", "--write"]) == 2
    assert "--write" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["dmu50", "trunnion_ac"])
def test_the_serial_chain_is_the_machine_without_errors(name: str) -> None:
    machine = Machine.load(name)
    chain = serial_chain(machine, 100.0)
    low, high = machine.limits.T
    q = np.random.default_rng(1).uniform(np.maximum(low, -3.0), np.minimum(high, 3.0), (5, len(machine.axes)))
    expected = Kinematics(machine, Calibration.zero(machine), tool_length_mm=100.0).forward(q / machine.scale)
    for i, pose in enumerate(map(chain.pose, q)):
        np.testing.assert_allclose(pose.translation * 1e3, expected.point_mm[i], atol=1e-9)  # rounding of a metre
        np.testing.assert_allclose(pose.rotation, expected.rotation[i], atol=1e-12)
    model = pinocchio_model(chain)
    assert model.nq == len(machine.axes) and model.existFrame("tip")
    for joint in chain.joints:
        np.testing.assert_allclose(joint.along_z.rotation[:, 2], joint.axis, atol=1e-12)
        assert np.linalg.det(joint.along_z.rotation) == pytest.approx(1.0)


def test_the_result_of_a_selection_counts_right_and_other_names() -> None:
    hidden = (("reversal", "Y"), ("pitch_error", "X"))
    assert result((*hidden, ("harmonic", "E_XC")), hidden) == "2 of 2 hidden effects named, 1 others"
    assert result((), hidden) == "0 of 2 hidden effects named, 0 others"
