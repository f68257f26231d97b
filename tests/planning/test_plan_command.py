"""Tests of `twin plan`: valid and invalid kit files, refused arguments, and a plan used by the other commands."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.planning import kits
from twin import cli
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.planning import Kit, Plan, duration
from twin.planning.kit import bundled_kit
from twin.samples import thesis_plan

KIT = """schema: twin.kit/1
source: what stands in the cupboard of a test
instruments: [tracker, interferometer]
stations:
  front: {origin_mm: [200, -1800, -150]}
  pillar: {origin_mm: [2000, -500, -100], turn_deg: [0, 0, 170], known: true}
targets:
  T: {carrier: tool, place_mm: [100, 0, -40]}
  U: {carrier: tool, place_mm: [-60, 90, -120], facing: [0, -2, 0], acceptance_deg: 60}
  V: {carrier: tool, place_mm: [-50, -90, -60], known: true}
seconds: {point: 10, aim: 15, target: 20, station: 600}
speeds: {X: 200}
ranges: {X: [50, 350]}
stops_the_beam: nothing
"""


def status(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        cli.main([str(argument) for argument in arguments])
    return int(stopped.value.code or 0)


@pytest.fixture
def slides(tmp_path: Path) -> Path:
    kits.slides(tmp_path)
    return tmp_path / "slides.yaml"


@pytest.fixture
def own(tmp_path: Path) -> Path:
    path = tmp_path / "kit.yaml"
    path.write_text(KIT)
    return path


def test_a_kit_file_is_read(own: Path, slides: Path) -> None:
    machine = Machine.load(str(slides))
    kit = Kit.load(own, machine)
    assert [one.name for one in kit.instruments] == ["tracker", "interferometer"]
    assert kit.known == {"pillar", "V"} and not kit.opaque
    assert kit.stations["pillar"].pose == pytest.approx([2000, -500, -100, 0, 0, 170])
    # Upright, with x towards the middle of the working volume: along y from the front.
    x = np.degrees(kit.stations["front"].rotation_rad[2])
    assert kit.stations["front"].rotation_rad[:2] == (0.0, 0.0) and 80.0 < x < 100.0
    assert kit.targets["U"].facing == (0.0, -1.0, 0.0) and kit.targets["T"].facing is None
    assert np.degrees(kit.targets["U"].acceptance_rad) == pytest.approx(60.0)
    assert (kit.seconds.point, kit.seconds.aim, kit.seconds.target, kit.seconds.station) == (10, 15, 20, 600)
    assert kit.speeds.tolist() == [200.0, 100.0] and kit.ranges.tolist() == [[50, 350], [-300, 0]]


@pytest.mark.parametrize(
    ("old", "new", "what", "expected"),
    [
        ("twin.kit/1", "twin.machine/1", "wrong kind of file", "schema: twin.kit/1"),
        ("[tracker, interferometer]", "[tracker, ruler]", "no such instrument", "tracker, tracker-absolute"),
        ("speeds: {X: 200}", "speeds: {A: 200}", "no such axis", "X, Z"),
        ("speeds: {X: 200}", "speeds: {X: -1}", "is invalid", "greater than 0"),
        ("ranges: {X: [50, 350]}", "ranges: {C: [50, 350]}", "no such axis", "X, Z"),
        ("ranges: {X: [50, 350]}", "ranges: {X: [50, 450]}", "the range is not within that of the machine", "0 … 400"),
        ("ranges: {X: [50, 350]}", "ranges: {X: [350, 50]}", "the range is not within that of the machine", "0 … 400"),
        ("facing: [0, -2, 0]", "facing: [0, 0, 0]", "facing is a zero vector", "aimed, or x, y, z"),
        ("facing: [0, -2, 0]", "facing: north", "is invalid", "aimed, or x, y, z"),
        ("acceptance_deg: 60", "acceptance_deg: 200", "is invalid", "less than or equal to 180"),
        ("carrier: tool, place_mm: [100", "carrier: bed, place_mm: [100", "is invalid", "'tool' or 'work'"),
        ("place_mm: [100, 0, -40]", "place_mm: [100, 0]", "is missing", "this entry"),
        ("{origin_mm: [200, -1800, -150]}", "{origin_mm: [200, -1800, .nan]}", "is invalid", "finite"),
        ("point: 10", "point: 0", "is invalid", "greater than 0"),
        ("stops_the_beam: nothing", "stops_the_beam: air", "is invalid", "'machine' or 'nothing'"),
        ("stops_the_beam: nothing", "colour: blue", "is invalid", "one of schema, source, "),
        ("seconds: {point: 10", "seconds: {point: 10: 3", "not YAML", "YAML"),
        ("speeds: {X: 200}", "source: again", "duplicate key", "each key once"),
    ],
)
def test_an_error_in_a_kit_names_its_line(
    own: Path, slides: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    old: str, new: str, what: str, expected: str,
) -> None:  # fmt: skip
    assert KIT.count(old) == 1
    own.write_text(KIT.replace(old, new))
    line = KIT[: KIT.index(old)].count("\n") + 1
    with pytest.raises(InputError) as caught:
        Kit.load(own, Machine.load(str(slides)))
    assert caught.value.file == str(own) and caught.value.line in (line, line + 1)
    assert what in caught.value.what and expected in caught.value.expected
    out = tmp_path / "p.csv"
    assert status("plan", "-o", out, "--machine", slides, "--kit", own) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and f"{own}:{caught.value.line}" in said
    assert not out.exists()


@pytest.mark.parametrize("entry", ["stations", "targets"])
def test_a_kit_needs_stations_and_targets(own: Path, slides: Path, entry: str) -> None:
    lines = KIT.splitlines()
    first = lines.index(f"{entry}:")
    lines[first] = f"{entry}: {{}}"
    del lines[first + 1 : first + (3 if entry == "stations" else 4)]
    own.write_text("\n".join(lines))
    with pytest.raises(InputError, match=entry):
        Kit.load(own, Machine.load(str(slides)))


def test_from_a_kit_to_a_calibration(
    own: Path, slides: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """plan, simulate, identify: each command reads the file of the one before; the errors identified are those predicted."""
    out, report = tmp_path / "p.csv", tmp_path / "p.json"
    assert status("plan", "-o", out, "--machine", slides, "--kit", own, "--minutes", 60, "--json", report) == 0
    text = capsys.readouterr().out
    said = json.loads(report.read_text())
    assert said["schema"] == "twin.plan/1" and said["kit"] == "what stands in the cupboard of a test"
    assert f"{said['points']} readings with tracker" in text and f"written: {out}, {report}" in text
    assert said["minutes"] <= 60.0 and sum(said["seconds"].values()) == pytest.approx(60.0 * said["minutes"])
    assert out.read_text().startswith("# plan by twin: slides") and "overrun" in out.read_text()
    machine = Machine.load(str(slides))
    table = Measurements.load(out, machine, plan=True)
    assert len(table) == said["points"] and not table.set_aside
    kit = Kit.load(own, machine)
    assert duration(machine, kit, table) / 60.0 == pytest.approx(said["minutes"], abs=0.01)
    assert table.positions[:, 0].min() >= 50.0 and table.positions[:, 0].max() <= 350.0
    # The report again, from the plan alone.
    assert status("plan", "--judge", out, "--machine", slides, "--kit", own, "--json", tmp_path / "j.json") == 0
    judged = json.loads((tmp_path / "j.json").read_text())
    assert judged["minutes"] == pytest.approx(said["minutes"], abs=0.01)
    assert judged["forecast"]["tool_point"]["u_rms_um"] == pytest.approx(
        said["forecast"]["tool_point"]["u_rms_um"], rel=1e-6
    )
    measured, found = tmp_path / "m.csv", tmp_path / "c.yaml"
    assert status("simulate", out, "-o", measured, "--machine", slides, "--seed", 3) == 0
    assert status("identify", measured, "-o", found, "--machine", slides, "--json", tmp_path / "i.json") == 0
    errors = {row["name"] for row in json.loads((tmp_path / "i.json").read_text())["errors"]}
    assert errors == {row["name"] for row in said["forecast"]["errors"]}


def test_judge_the_thesis(tmp_path: Path, dmu50: Machine, capsys: pytest.CaptureFixture[str]) -> None:
    report = tmp_path / "j.json"
    assert status("plan", "--judge", "thesis_plan.csv", "--json", report) == 0
    text = capsys.readouterr().out
    minutes = duration(dmu50, Kit.default(dmu50), thesis_plan.plan(dmu50)) / 60.0
    assert f"840 readings with tracker, {minutes:.0f} minutes" in text
    for word in ("E_B0Z", "not identifiable", "E_X0B", "O1", "µrad"):
        assert word in text
    assert json.loads(report.read_text())["minutes"] == pytest.approx(minutes)


@pytest.mark.sample(21)  # of 26
@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ((), "no output, or two outputs"),
        (("-o", "p.csv", "--judge", "thesis_plan.csv"), "no output, or two outputs"),
        (("-o", "p.csv", "--minutes", "0"), "--minutes"),
        (("-o", "p.csv", "--minutes", "5"), "time budget is too short for a measurement"),
        (("-o", "p.csv", "--seed", "-1"), "--seed must not be negative"),
        (("-o", "p.csv", "--reduce", "E_QQ"), "no such uncertainty to minimise"),
        (("-o", "p.csv", "--after", "m.csv"), "--after needs --separate"),
        (("-o", "p.csv", "--reduce", "tool", "--separate", "reversal X", "reversal Y"), "--separate and --reduce"),
        (("-o", "p.csv", "--separate", "warp X", "reversal Y"), "not a cause that a plan can separate"),
        (("-o", "p.csv", "--separate", "reversal W", "reversal Y"), "not a cause that a plan can separate"),
        (("-o", "p.csv", "--separate", "refraction_scale", "reversal Y"), "not a cause that a plan can separate"),
        (("-o", "p.csv", "--separate", "reversal X colour=3", "reversal Y"), "no such parameter"),
        (("-o", "p.csv", "--separate", "reversal X size=big", "reversal Y"), "not a number"),
        (("-o", "p.csv", "--kit", "nothing.yaml"), "nothing.yaml"),
        (("-o", "p.csv", "--sequence", "turns"), "a measuring sequence needs its instrument"),
        (("-o", "p.csv", "--instrument", "tracker", "--spheres", "1,2,3"), "a measuring sequence needs its instrument"),
        (("-o", "p.csv", "--instrument", "probe", "--sequence", "turnz"), "no such sequence"),
        (("-o", "p.csv", "--instrument", "probe", "--reduce", "tool"), "no --separate and no --reduce"),
        (("-o", "p.csv", "--instrument", "probe", "--spheres", "1,2"), "--spheres"),
        (("-o", "p.csv", "--instrument", "probe", "--clearance", "0"), "--clearance"),
        (("-o", "p.csv", "--instrument", "probe", "--minutes", "5"), "time budget is too short"),
        (("-o", "p.csv", "--instrument", "r-test", "--program", "p.ngc"), "touch probe"),
        (("-o", "missing/p.csv"), "missing"),
        (("--judge", "nothing.csv"), "nothing.csv"),
        (("--judge", "thesis_plan.csv", "--sequence", "turns"), "--judge evaluates an existing plan"),
        (("--judge", "thesis_plan.csv", "--instrument", "ruler"), "ruler"),
    ],
)
def test_refusals(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...], what: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.csv").write_text("")
    assert status("plan", *arguments) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and what in said
    assert [path.name for path in tmp_path.iterdir()] == ["m.csv"]


def test_an_output_that_is_an_input_is_refused(own: Path, slides: Path) -> None:
    assert status("plan", "-o", own, "--machine", slides, "--kit", own) == 2
    assert own.read_text() == KIT


def test_the_bundled_kit(dmu50: Machine, tmp_path: Path) -> None:
    """The bundled kit is found by name, a copy of it by path."""
    path = bundled_kit("dmu50")
    kit = Kit.load(path, dmu50)
    assert "ILLUSTRATIVE" in path.read_text() and "ILLUSTRATIVE" in kit.source
    assert {target.carrier for target in kit.targets.values()} == {"tool", "work"}
    copy = tmp_path / "mine.yaml"
    copy.write_text(path.read_text())
    assert bundled_kit(str(copy)) == copy
    with pytest.raises(InputError, match=r"dmu50\.kit\.yaml"):
        bundled_kit("dmu51")


@pytest.mark.slow
def test_coordinates_entered_into_a_plan_do_not_make_its_positions_known(half: Plan, tmp_path: Path) -> None:
    """A planned position of a reflector is not a known one unless the kit has `known: true`."""
    half.save(tmp_path / "p.csv")
    header, *rows = [line for line in (tmp_path / "p.csv").read_text().splitlines() if not line.startswith("#")]
    measured = tmp_path / "m.csv"
    measured.write_text("\n".join([f"{header},x_mm,y_mm,z_mm", *(f"{row},1,2,3" for row in rows)]) + "\n")
    plan, data = (
        Measurements.load(path, half.machine, plan=path != measured) for path in (tmp_path / "p.csv", measured)
    )
    assert np.allclose(plan.place_mm, half.table.place_mm) and np.allclose(plan.station_pose, half.table.station_pose)
    assert np.isnan(data.place_mm).all() and np.isnan(data.station_pose).all()
    assert not any("planned" in notice for notice in data.notices)
    one = next(iter(half.kit.targets))
    known = replace(half.kit, targets={**half.kit.targets, one: replace(half.kit.targets[one], known=True)})
    replace(half, kit=known).save(tmp_path / "k.csv")
    loaded = Measurements.load(tmp_path / "k.csv", half.machine, plan=True)
    assert np.allclose(loaded.place_mm, half.table.place_mm)
    assert "place_x_mm" in (tmp_path / "k.csv").read_text().replace("planned_place_x_mm", "")


@pytest.mark.slow
def test_several_errors_behind_one_reduce(
    slides: Path, own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--reduce` takes several names."""
    out, report = tmp_path / "p.csv", tmp_path / "r.json"
    arguments = ["plan", "-o", out, "--machine", slides, "--kit", own, "--json", report, "--reduce", "E_XX", "E_YX"]
    assert status(*arguments) == 0
    assert json.loads(report.read_text())["aim"] == "E_XX E_YX"
