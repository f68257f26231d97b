"""Every command repeats what an identification could not determine, and counts it in U."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from tests.cli.test_warnings_travel import PROGRAMS, run
from twin._common.errors import InputError
from twin.compensation.live import make_module
from twin.identification.thesis import identify_as_thesis
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.simulate import simulate
from twin.model.calibration import Calibration
from twin.model.unknown_errors import nominal_locations
from twin.samples import thesis_plan

Files = dict[str, Path]
TITLE: Final = "NOT IDENTIFIED"


@pytest.fixture(scope="module")
def measured(dmu50: Machine, calibration: Calibration, tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Identify a round of the thesis's plan with all reflectors, and with one on either side."""
    folder = tmp_path_factory.mktemp("identified")
    plan = thesis_plan.plan(dmu50)
    readings, _ = simulate(
        plan.select(plan.round == "1"), dmu50, calibration, LaserTracker(), np.random.default_rng(11)
    )
    names = {side: readings.target[readings.carrier == side][0] for side in ("tool", "work")}
    found = {}
    for kind, data in (("all", readings), ("one", readings.select(np.isin(readings.target, list(names.values()))))):
        data.save(folder / f"{kind}.csv", dmu50)
        found[kind] = folder / f"{kind}.yaml"
        assert run("identify", folder / f"{kind}.csv", "-o", found[kind]) == 0
    return found


def loaded(path: Path) -> Any:
    return json.loads(path.read_text())


def test_the_file_says_what_is_not_known(measured: Files, dmu50: Machine) -> None:
    every, one = (Calibration.load(measured[kind], dmu50) for kind in ("all", "one"))
    assert every.set_up is not None and (every.set_up.targets_on_tool, every.set_up.targets_on_work) == (3, 3)
    assert one.set_up is not None and (one.set_up.targets_on_tool, one.set_up.targets_on_work) == (1, 1)
    assert every.instruments == one.instruments == ("tracker",)
    assert every.misfit is not None and every.misfit.verdict == "consistent" and every.misfit.dof is not None
    names = {kind: {entry.name for entry in of.not_identifiable} for kind, of in (("all", every), ("one", one))}
    # The readings are of targets at unknown places: where the rotary axes are relative to the spindle is not known.
    assert names["all"] == {"E_X0B", "E_Y0B", "E_Y0C"}
    assert names["all"] < names["one"] and len(names["one"]) > 20
    assert all(entry.why for entry in (*every.not_identifiable, *one.not_identifiable))


@pytest.mark.sample(1)  # of 2
@pytest.mark.parametrize("kind", ["all", "one"])
def test_every_command_says_it(
    kind: str,
    without_pictures: None,
    measured: Files,
    dmu50: Machine,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    given, out = ("-c", measured[kind], "--tool-length", 120), tmp_path / "out.json"
    unknown = ("E_X0B", "E_Y0B", "E_Y0C")
    (tmp_path / "p.nc").write_text(PROGRAMS["p.nc"])

    def said(*command: object) -> Any:
        capsys.readouterr()
        assert run(*command, "--json", out) == 0
        assert TITLE in capsys.readouterr().out
        found = loaded(out)
        warnings = found.get("warnings") or found["calibration"]["warnings"]
        assert "not_identifiable" in {one["name"] for one in warnings}
        return found

    found = said("compensate", tmp_path / "p.nc", "-o", tmp_path / "o.nc", *given)
    assert TITLE in (tmp_path / "o.nc").read_text().upper()
    counted = found["uncertainty"]["not_identified"]
    assert tuple(counted["names"]) == unknown
    # Three locations of 1 mm each: the radius of 95 % is larger than that of one.
    assert counted["expanded_rms_um"] > 1960.0 > found["uncertainty"]["point"]["expanded_rms_um"] or kind == "one"
    found = said("volume", "--trials", 2000, "--poses", 5, "--workers", 1, *given)
    assert tuple(found["not_identified"]) == unknown
    assert found["first_order"]["rms_um"] > 1960.0
    assert found["first_order_identified_errors"]["rms_um"] < found["first_order"]["rms_um"]
    found = said("info", *given)
    assert found["uncertainty"]["rms_um"] > 1960.0
    found = said("report", "-o", tmp_path / "r.html", *given)
    assert tuple(found["compensation"]["not_identified"]) == unknown
    assert found["compensation"]["compensated"]["rms_um"] > 1000.0
    assert found["budget"]["total"]["U_rms_um"] > 1960.0
    assert {one["name"] for one in found["gaps"]["not_identified"]} >= set(unknown)
    page = (tmp_path / "r.html").read_text()
    assert TITLE in page and "cannot be separated from" in page
    found = said("compare", measured[kind], measured["all"], "--tool-length", 120, "--tolerance", 0.05)
    assert [one["error"] for one in found["not_identified"]] == list(unknown)
    assert found["first_compensating_second"]["good_enough"] is None


def test_good_tables_are_written_and_those_of_one_reflector_are_refused(
    measured: Files, dmu50: Machine, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.json"
    given = ("--to", "siemens", "--tool-length", 120)
    assert run("control", *given, "-c", measured["all"], "-o", tmp_path / "all", "--json", out) == 0
    found = loaded(out)
    assert len(found["tables"]) > 8
    written = {one["table"] for one in found["tables"]}
    assert all(one["u_rms"] > one["rms"] and one["name"] not in written for one in found["unproven_tables"])
    assert (
        found["error_at_tool"]["uncertainty"]["rms_um"]
        > 1960.0
        > found["error_at_tool"]["uncertainty"]["identified_rms_um"]
    )
    assert (
        TITLE in (tmp_path / "all" / "cec.mpf").read_text() and TITLE in (tmp_path / "all" / "README.txt").read_text()
    )
    assert "not_identifiable" in (tmp_path / "all" / "calibration.yaml").read_text()
    capsys.readouterr()
    status = run("control", *given, "-c", measured["one"], "-o", tmp_path / "one")
    said = capsys.readouterr()
    assert status in (2, 3)
    assert not (tmp_path / "one").exists() if status == 2 else "Not written" in said.out
    assert run("control", *given, "-c", measured["one"], "-o", tmp_path / "forced", "--force") == 0
    assert "WRITTEN ALTHOUGH U" in (tmp_path / "forced" / "README.txt").read_text()
    assert "NOT SHOWN TO BE AN IMPROVEMENT" in (tmp_path / "forced" / "cec.mpf").read_text()


@pytest.mark.parametrize("form", ["siemens-chain", "siemens-trafo5", "heidenhain-kinematics"])
def test_kinematics_with_an_unidentified_location_are_refused(
    form: str, measured: Files, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ("control", "--kinematics", form, "-c", measured["all"], "-o", tmp_path / "out")
    capsys.readouterr()
    assert run(*given) == 2
    said = capsys.readouterr().err
    assert "E_X0B, E_Y0B, E_Y0C were not identified" in said and "--force" in said and "all.yaml" in said
    assert not (tmp_path / "out").exists()
    assert run(*given, "--force") == 0
    for path in (tmp_path / "out").iterdir():
        if path.name != "calibration.yaml":
            assert "KINEMATICS NOT IDENTIFIED: E_X0B, E_Y0B, E_Y0C" in path.read_text(), path.name


def test_locations_left_out_on_request_bar_kinematics(measured: Files, tmp_path: Path) -> None:
    folder = measured["all"].parent
    only = ("--only", "E_*X", "E_X0C", "E_A0C", "E_B0C")
    assert run("identify", folder / "all.csv", "-o", tmp_path / "some.yaml", *only) == 0
    assert "not_estimated" in (tmp_path / "some.yaml").read_text()
    assert run("control", "--kinematics", "siemens-chain", "-c", tmp_path / "some.yaml", "-o", tmp_path / "k") == 2
    assert not (tmp_path / "k").exists()


def test_an_axis_run_says_what_it_did_not_measure(
    dmu50: Machine, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Six of the machine's errors are measured; every other one is unknown, of the size that the machine file states."""
    layout, path, out = ("--layout", "nine_beams_x.yaml"), tmp_path / "x.yaml", tmp_path / "out.json"
    assert run("simulate-run", *layout, "--positions", "0,500,21", "-o", tmp_path / "run.csv") == 0
    assert run("axis-run", tmp_path / "run.csv", *layout, "-o", path) == 0
    found = Calibration.load(path, dmu50)
    every = {*dmu50.motion_names, *dmu50.squareness_names, *dmu50.location_names}
    why = {entry.name: entry.why for entry in found.not_identifiable}
    assert set(why) == every - {f"E_{letter}X" for letter in "XYZABC"}
    assert why["E_XY"] == "Y did not move" and why["E_X0C"] == "C did not move"
    assert found.misfit is not None and found.misfit.verdict == "consistent" and found.misfit.p_value is not None
    assert found.set_up is not None and found.set_up.targets_on_tool > 0 == found.set_up.targets_on_work
    assert found.set_up.points == 3 * 2 * 21  # rounds, directions, positions
    capsys.readouterr()
    assert run("control", "--kinematics", "siemens-chain", "-c", path, "-o", tmp_path / "k") == 2
    assert "E_X0B: B did not move" in capsys.readouterr().err and not (tmp_path / "k").exists()
    given = ("-c", path, "--tool-length", 120, "--json", out)
    assert run("volume", "--trials", 1000, "--poses", 2, "--workers", 1, *given) == 0
    budget = loaded(out)
    assert set(budget["not_identified"]) == set(why)
    # One location of 1 mm alone gives 1.96 mm.
    assert budget["first_order"]["rms_um"] > 1960.0 > 10.0 > budget["first_order_identified_errors"]["rms_um"]


def test_the_thesis_method_says_what_it_cannot_identify(
    dmu50: Machine, calibration: Calibration, tmp_path: Path
) -> None:
    readings, _ = simulate(thesis_plan.plan(dmu50), dmu50, calibration, LaserTracker(), np.random.default_rng(3))
    found = identify_as_thesis(readings, dmu50).calibration
    assert {entry.name for entry in found.not_identifiable} == set(dmu50.location_names)
    assert found.misfit is not None and found.misfit.verdict == "untested"
    assert found.set_up is not None and found.set_up.points == len(readings)
    found.save(tmp_path / "thesis.yaml")
    assert Calibration.load(tmp_path / "thesis.yaml", dmu50).not_identifiable == found.not_identifiable
    assert [one.errors for one in nominal_locations(found)] == [dmu50.location_names]  # bars kinematics
    with pytest.raises(InputError, match="were not identified"):
        make_module(found)
