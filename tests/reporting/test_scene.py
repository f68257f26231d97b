"""Tests of the scene: content of the page, its data, and its picture in a browser."""

from __future__ import annotations

import base64
import json
import re
import shutil
import socket
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import umsgpack

import twin
from tests.browser import run_chromium
from tests.model.errors import random_calibration
from tests.truth.png import read_png
from twin._common.errors import InputError
from twin._common.provenance import ILLUSTRATIVE
from twin.compensation.programs.execute import execute_file
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.reporting.scene.draw import SECONDS, draw_program, scene_html
from twin.reporting.scene.path import (
    MAX_KEYFRAMES,
    ScenePath,
    arrow_blocks,
    chosen_exaggeration,
    keyframes,
    rounded_125,
    runs,
    scale_top_um,
    thinned,
    tube,
    viridis,
)
from twin.tool.forward import Kinematics

TOOL_MM = 90.0
VIRIDIS = {0.0: "#440154", 0.5: "#21918c", 1.0: "#fde725"}  # as published, to the last bit


@pytest.fixture(scope="module")
def real(dmu50: Machine) -> Kinematics:
    return Kinematics(dmu50, random_calibration(dmu50, np.random.default_rng(5), 100.0), tool_length_mm=TOOL_MM)


def no_gaps(points: int) -> np.ndarray:
    return np.arange(points) == 0


def motion(real: Kinematics, points: int = 400) -> ScenePath:
    """Return a rapid move, then a move of all five axes, on the machine with errors."""
    t = np.linspace(0.0, 1.0, points)
    q = np.column_stack([150 + 200 * t, 225 + 80 * np.sin(6 * t), -250 + 60 * np.cos(6 * t), 20 + 120 * t, 400 * t])
    q = np.vstack([[100, 100, 0, 0, 0], q])
    nominal = Kinematics(real.machine, Calibration.zero(real.machine), tool_length_mm=TOOL_MM)
    cutting = np.arange(len(q)) > 1
    return ScenePath(
        q,
        nominal.forward(q).point_mm,
        real.forward(q).point_mm,
        cutting,
        10 * np.arange(1, len(q) + 1),
        no_gaps(len(q)),
    )


def ring(machine: Machine, largest_um: float, points: int = 300) -> ScenePath:
    """Return a circle in the plane of the table with a radial deviation that grows linearly to ``largest_um``."""
    t = np.linspace(0.0, 2 * np.pi, points)
    out = np.column_stack([np.cos(t), np.sin(t), 0 * t])
    nominal = 60 * out + [0, 0, 40]
    q = np.column_stack([250 + nominal[:, 0], 225 + nominal[:, 1], -400 + TOOL_MM + nominal[:, 2], 0 * t, 0 * t])
    actual = nominal + out * (largest_um * 1e-3 * t / t[-1])[:, None]
    return ScenePath(q, nominal, actual, np.ones(points, dtype=bool), np.arange(points) + 5, no_gaps(points))


def commands(page: str) -> list[dict[str, Any]]:
    """Return meshcat's drawing commands, decoded from the page."""
    found = re.search(r"for \(const command of (\[.*?\])\)", page)
    assert found is not None
    return [umsgpack.unpackb(base64.b64decode(text)) for text in json.loads(found[1])]


def page_data(page: str) -> dict[str, Any]:
    found = re.search(r"const page = (\{.*\});\n", page)
    assert found is not None
    return dict(json.loads(found[1]))


@pytest.fixture(scope="module")
def page(real: Kinematics) -> str:
    return scene_html(real, motion(real), title="a <b>program</b> & more", warnings=(ILLUSTRATIVE,))


# ---- content of the page


def test_nothing_is_loaded_from_elsewhere(page: str) -> None:
    own = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)
    assert not re.findall(r"https?:|url\(|@import", own)
    assert re.findall(r"(?:src|href)=\"([^\"]*)\"", own) == ["data:,"]
    # This policy makes the browser refuse every request and report it on the console, which is tested below.
    assert "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:" in own


def test_no_server_no_process_and_no_output(
    real: Kinematics, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a scene needs no process and no port")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    monkeypatch.setattr(socket.socket, "bind", refuse)
    scene_html(real, motion(real, 20), title="quiet")
    assert capfd.readouterr() == ("", "")


def test_the_same_input_gives_the_same_page(real: Kinematics) -> None:
    assert scene_html(real, motion(real, 30), title="t") == scene_html(real, motion(real, 30), title="t")


def test_title_is_text_not_markup(page: str) -> None:
    assert "<h1>a &lt;b&gt;program&lt;/b&gt; &amp; more</h1>" in page and "<b>program" not in page


def test_illustrative_warning_only_if_illustrative(real: Kinematics, page: str) -> None:
    assert ILLUSTRATIVE.text in page
    assert "ILLUSTRATIVE" not in scene_html(real, motion(real, 5), title="t")


def test_legend(real: Kinematics) -> None:
    path = ring(real.machine, 8.0)
    text = re.sub(r"<script>.*?</script>", "", scene_html(real, path, title="t"), flags=re.DOTALL)
    assert re.findall(r"<span>([\d.]+)</span>", text) == ["0", "2", "4", "6", "8"]
    assert "max</span> <b>8 µm</b> <span>at line 304</span>" in text
    # Root mean square of linear growth from 0 to 8 over 300 points, to three digits.
    rms = np.sqrt(np.mean(np.linspace(0, 8, 300) ** 2))
    assert f"<b>{rms:.2f} µm</b>" in text
    # 8 % of the diagonal of 120 mm × 120 mm over 8 µm is 1697: 2000.
    assert "deviation × 2\u202f000" in text


def test_statistics_cover_cutting_moves_only(real: Kinematics) -> None:
    path = motion(real, 50)
    actual = path.actual_mm.copy()
    actual[0] += 5.0
    wild_rapid = replace(path, actual_mm=actual)
    assert wild_rapid.max_um == path.max_um and wild_rapid.rms_um == path.rms_um
    all_rapid = replace(wild_rapid, cutting=np.zeros(51, dtype=bool))
    assert all_rapid.max_um > 5000 and all_rapid.worst == 0


@pytest.mark.parametrize(
    ("value", "expected"),
    [(1.0, 1), (1.4, 1), (1.5, 2), (3.1, 2), (3.3, 5), (7.0, 5), (7.2, 10), (1697, 2000), (0.031, 0.02), (99999, 1e5)],
)
def test_rounding_of_the_exaggeration(value: float, expected: float) -> None:
    assert rounded_125(value) == pytest.approx(expected, rel=1e-12)


def test_exaggeration(dmu50: Machine) -> None:
    """The largest deviation is drawn at about 8 % of the extent, up to rounding to 1, 2, 5; the factor is at least 1."""
    for largest in (0.3, 5.0, 40.0, 900.0):
        path = ring(dmu50, largest)
        share = chosen_exaggeration(path) * largest * 1e-3 / path.extent_mm
        assert 0.08 / np.sqrt(2.5) * 0.99 < share < 0.08 * np.sqrt(2.5) * 1.01
    assert chosen_exaggeration(ring(dmu50, 0.0)) == 1.0
    assert chosen_exaggeration(ring(dmu50, 5e5)) == 1.0


def test_scale_ends_at_or_just_above_the_maximum() -> None:
    assert [scale_top_um(v) for v in (0.0, 8.0, 8.1, 0.31, 10.4, 250.0)] == pytest.approx([1, 8, 10, 0.4, 12, 300])
    for value in np.random.default_rng(0).uniform(0.01, 5000, 500):
        assert value <= scale_top_um(float(value)) <= 1.4 * value


def test_colours_are_viridis() -> None:
    for share, name in VIRIDIS.items():
        assert (255 * viridis(np.array([share]))[0]).round().astype(int).tolist() == list(bytes.fromhex(name[1:]))


def test_number_of_arrows_and_the_worst_point(real: Kinematics) -> None:
    path = motion(real)
    blocks = arrow_blocks(path, 24)
    assert 12 <= len(blocks) <= 24 and path.worst in blocks and np.all(path.cutting[blocks])
    assert len(arrow_blocks(path, 0)) == 0 and arrow_blocks(path, 1).tolist() == [path.worst]


def test_runs_and_thinning_keep_ends_and_the_worst() -> None:
    cutting = np.array([False, False, True, True, True, False, True])
    assert [run.tolist() for run in runs(cutting)] == [[1, 2, 3, 4], [5, 6]]
    assert [run.tolist() for run in runs(~cutting)] == [[0, 1], [4, 5]]
    (thin,) = thinned([np.arange(10_000)], 100, 4321)
    assert len(thin) <= 101 and thin[0] == 0 and thin[-1] == 9999 and 4321 in thin


def test_a_tube_keeps_its_radius_round_reversals_and_repeated_points() -> None:
    line = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 1, 0], [1, 0, 0], [1, 0, 0], [1, 0, 3.0]])
    mesh = tube(line, np.full(7, 0.1), np.zeros((7, 3)), 6)
    from_line = np.linalg.norm(mesh.vertices.reshape(7, 6, 3) - line[:, None], axis=2)
    assert np.abs(from_line - 0.1).max() < 1e-12
    assert mesh.faces.min() == 0 and mesh.faces.max() == 41


# ---- animation


@pytest.mark.parametrize("points", [1, 2, 37, 599, 600, 601, 5000])
def test_keyframes_are_limited_evenly_spaced_and_on_the_path(real: Kinematics, points: int) -> None:
    path = motion(real, points)
    machine = real.machine
    frames = keyframes(path, machine.linear, machine.rotary)
    assert len(frames.share) <= MAX_KEYFRAMES and np.all(np.diff(frames.share) > 0)
    assert np.array_equal(frames.positions[0], path.positions[0])
    assert np.allclose(frames.positions[-1], path.positions[-1], rtol=0, atol=1e-9)
    assert frames.share[0] == 0 and frames.share[-1] == 1 and frames.block[-1] == points
    if points > 2:
        steps = np.diff(frames.positions, axis=0)
        way = np.linalg.norm(steps[:, :3], axis=1) + np.linalg.norm(steps[:, 3:], axis=1)
        cutting = path.cutting[frames.block[1:]] & path.cutting[frames.block[:-1]]
        speed = (way / np.diff(frames.share))[cutting]
        # With more points than keyframes, corners are cut; this smooth path changes by very little.
        assert speed.max() / speed.min() < 1.01


@pytest.mark.parametrize("points", [20, 5000])
def test_animation_and_arrows_jump_over_a_gap(dmu50: Machine, points: int) -> None:
    """Half a circle, then the other half 100 mm from it."""
    path = ring(dmu50, 8.0, points)
    after = np.arange(points) >= points // 2
    far = 100.0 * after[:, None]
    path = replace(
        path,
        positions=path.positions + far * [1, 0, 0, 0, 0],
        nominal_mm=path.nominal_mm + far * [1, 0, 0],
        actual_mm=path.actual_mm + far * [1, 0, 0],
        gaps=no_gaps(points) | (np.arange(points) == points // 2),
    )
    frames = keyframes(path.drawn(), dmu50.linear, dmu50.rotary)
    assert len(frames.share) <= MAX_KEYFRAMES
    (jump,) = np.flatnonzero(np.diff(frames.positions[:, 0]) > 50)
    assert 0 < np.diff(frames.share.round(6))[jump] * SECONDS < 1e-3  # as the page has it; no picture falls within
    assert frames.share[jump] == pytest.approx(0.5, abs=0.03)
    steps = np.linalg.norm(np.delete(np.diff(frames.positions, axis=0), jump, axis=0), axis=1)
    assert steps.max() < (20.0 if points == 20 else 1.0)
    assert np.count_nonzero(after[arrow_blocks(path, 20)]) == pytest.approx(10, abs=1)
    # Without motion between two gaps there is nothing to animate.
    still = replace(path, gaps=np.ones(points, dtype=bool))
    assert len(keyframes(still, dmu50.linear, dmu50.rotary).share) == 1


def test_both_ends_of_a_gap_are_drawn(dmu50: Machine) -> None:
    """Also where they are on one line of the program, and close to each other."""
    at = np.arange(40) * [[0.1], [0], [0], [0], [0]]
    path = ScenePath(at.T, at[:3].T, at[:3].T, np.ones(40, dtype=bool), np.ones(40, dtype=int), np.arange(40) % 17 == 0)
    drawn = path.drawn()
    assert drawn.positions[:, 0] == pytest.approx([0.0, 1.6, 1.7, 3.3, 3.4, 3.9])
    assert drawn.gaps.tolist() == [True, False, True, False, True, False]


BROKEN = {
    "unknown statement": "FOO(1)\nG1 X7\nG53 G0 X400 Y0 Z-1 B0 C0",
    "machine coordinates": "G53 G0 X400",
    "outside the axis ranges": "G1 Y-300\nX400\nY0",
    "rapids outside the axis ranges": "G0 Y-300\nX400\nY0",
}
"""Statements between two cuts."""


@pytest.mark.parametrize("name", BROKEN)
def test_nothing_is_drawn_where_the_way_is_not_known(dmu50: Machine, tmp_path: Path, name: str) -> None:
    """The cuts before and after a jump of about 400 mm are 6 mm and 1 mm long."""
    (tmp_path / "p.nc").write_text(f"G0 X0 Y0 Z-100 B0 C0\nG1 X6 F500\n{BROKEN[name]}\nG1 X399\nM30\n")
    scene = draw_program(tmp_path / "p.nc", dmu50)
    sent = {c["path"].rsplit("/", 1)[-1]: c for c in commands(scene.html) if c["type"] == "set_object"}
    drawn = {name: c["object"]["geometries"][0].get("data") for name, c in sent.items()}
    assert "rapids" not in drawn
    for part in ("fine", "bold", "nominal"):
        points = np.frombuffer(drawn[part]["attributes"]["position"]["array"].data, dtype=np.float32).reshape(-1, 3)
        faces = np.frombuffer(drawn[part]["index"]["array"].data, dtype=np.uint32).reshape(-1, 3)
        assert np.ptp(points, axis=0).max() > 0.3, "both cuts are drawn"
        assert np.linalg.norm(points[faces] - points[np.roll(faces, 1, axis=1)], axis=2).max() < 0.02
    data = page_data(scene.html)
    steps = np.abs(np.diff(data["q"], axis=0)).max(axis=1)
    assert np.count_nonzero(steps > 1.0) == 1 and np.diff(data["share"])[np.argmax(steps)] * SECONDS < 1e-3


def test_a_path_without_motion_is_one_keyframe(real: Kinematics) -> None:
    path = motion(real, 10)
    still = replace(path, positions=np.tile(path.positions[3], (11, 1)))
    assert len(keyframes(still, (0, 1, 2), (3, 4)).share) == 1
    text = scene_html(real, still, title="still")
    assert '<body class="still">' in text
    assert not [c for c in commands(text) if c["type"] == "set_animation"]


def test_final_pose_of_the_animation_is_forward_kinematics(real: Kinematics, page: str) -> None:
    path = motion(real)
    (animation,) = [c for c in commands(page) if c["type"] == "set_animation"]
    tracks = {
        a["path"].split("/")[-1]: {t["name"]: t["keys"] for t in a["clip"]["tracks"]} for a in animation["animations"]
    }
    # One node per moving link, none for the bed or a shape.
    assert set(tracks) == {"x_slide", "y_slide", "spindle", "spindle_nose", "cradle", "table"}
    assert all(len(keys) <= MAX_KEYFRAMES for track in tracks.values() for keys in track.values())

    def pose(link: str, key: int) -> tuple[np.ndarray, np.ndarray]:
        x, y, z, w = tracks[link][".quaternion"][key]["value"]
        n = np.array([x, y, z])
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turn = np.eye(3) * (w * w - n @ n) + 2 * np.outer(n, n) + 2 * w * cross
        assert tracks[link][".position"][key]["time"] == pytest.approx(SECONDS if key else 0.0, abs=1e-5)
        return turn, np.array(tracks[link][".position"][key]["value"])

    for key, command in ((0, path.positions[0]), (-1, path.positions[-1])):
        tool_turn, tool_at = pose("spindle_nose", key)
        work_turn, work_at = pose("table", key)
        tip_mm = work_turn.T @ (tool_at + tool_turn @ [0, 0, -TOOL_MM * 1e-3] - work_at) * 1e3
        expected = real.forward(command).point_mm[0]
        # Single precision of metres and quaternions at a radius of 0.5 m: about 10⁻⁴ mm.
        assert np.abs(tip_mm - expected).max() < 5e-4
    assert np.linalg.norm(path.actual_mm[-1] - path.nominal_mm[-1]) > 5e-3  # the errors are included


def test_path_is_exaggerated_in_the_frame_of_the_table(real: Kinematics) -> None:
    path = ring(real.machine, 8.0)
    drawn = {
        c["path"]: c["object"]
        for c in commands(scene_html(real, path, title="t", exaggeration=1000))
        if c["type"] == "set_object"
    }
    tube_of_path = drawn["/meshcat/machine/table/fine"]["geometries"][0]["data"]["attributes"]["position"]["array"].data
    points = np.frombuffer(tube_of_path, dtype=np.float32).reshape(300, 6, 3).mean(axis=1) * 1e3
    expected = path.nominal_mm + 1000 * (path.actual_mm - path.nominal_mm)
    assert np.abs(points - expected).max() < 1e-3  # single precision of coordinates below 0.1 m: 10⁻⁵ mm
    assert "/meshcat/machine/table/arrows" in drawn and "/meshcat/machine/table/rapids" not in drawn


@pytest.mark.slow
def test_size_of_the_page(real: Kinematics, page: str) -> None:
    """The size of the page is limited for long programs and for many lift-offs."""
    assert len(page) < 3e6
    long = motion(real, 20_000)
    assert len(scene_html(real, long, title="t")) < 5e6
    assert len(scene_html(real, replace(long, cutting=np.arange(20_001) % 5 > 1), title="t")) < 6e6


@pytest.mark.parametrize("name", ["trunnion_ac", "xyzbc_trunnion"])
def test_another_machine(name: str) -> None:
    machine = Machine.load(name)
    real = Kinematics(machine, random_calibration(machine, np.random.default_rng(2), 50.0), tool_length_mm=60)
    lower = [axis.lower if axis.lower is not None else -90.0 for axis in machine.axes]
    upper = [axis.upper if axis.upper is not None else 90.0 for axis in machine.axes]
    q = np.linspace(lower, upper, 12)
    path = ScenePath(
        q, real.forward(q).point_mm, real.forward(q).point_mm, np.ones(12, dtype=bool), np.arange(12), no_gaps(12)
    )
    text = scene_html(real, path, title=name)
    # Without deviation: factor 1, no arrow, but a colour scale.
    assert "deviation × 1<" in text and "/arrows" not in json.dumps([c["path"] for c in commands(text)])


# ---- bad input


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"positions": np.zeros((0, 5))}, "nothing to show"),
        ({"positions": np.zeros((6, 4))}, "positions has the wrong shape"),
        ({"nominal_mm": np.zeros((5, 3))}, "nominal_mm has the wrong shape"),
        ({"cutting": np.ones((6, 1), dtype=bool)}, "cutting has the wrong shape"),
        ({"actual_mm": np.full((6, 3), np.nan)}, "actual_mm contains a value that is not finite"),
    ],
)
def test_invalid_path(real: Kinematics, change: dict[str, np.ndarray], what: str) -> None:
    with pytest.raises(InputError, match=what):
        scene_html(real, replace(motion(real, 5), **change), title="t")


@pytest.mark.parametrize(
    "factor",
    [0.0, np.inf],
)
def test_a_factor_out_of_range(real: Kinematics, factor: float) -> None:
    with pytest.raises(InputError, match="exaggeration"):
        scene_html(real, motion(real, 5), title="t", exaggeration=factor)


def test_a_shape_that_cannot_be_drawn(real: Kinematics, tmp_path: Path) -> None:
    for suffix in (".yaml", ".urdf"):
        shutil.copy(real.machine.path.with_suffix(suffix), tmp_path)
    file = tmp_path / "dmu50.yaml"
    file.write_text(re.sub("calibration: .*", "", file.read_text()))
    urdf = tmp_path / "dmu50.urdf"
    urdf.write_text(re.sub(r'<box size="[^"]*"/>', '<mesh filename="nowhere.stl"/>', urdf.read_text(), count=1))
    machine = Kinematics(Machine.load(file), tool_length_mm=TOOL_MM)
    with pytest.raises(InputError, match="boxes, cylinders and spheres") as caught:
        scene_html(machine, motion(real, 3), title="t")
    assert caught.value.file == str(urdf.resolve())


# ---- in a browser


WIDTH, HEIGHT = 1200, 800


def look(text: str, folder: Path, hash: str = "#t=1") -> tuple[np.ndarray, list[str]]:
    """Return a screenshot of a page, and the lines on its console."""
    (folder / "scene.html").write_text(text, encoding="utf-8")
    options = [
        "--virtual-time-budget=3000",
        "--enable-logging=stderr",
        "--v=0",
        f"--window-size={WIDTH},{HEIGHT}",
        f"--user-data-dir={folder}/profile",
        f"--screenshot={folder}/scene.png",
    ]
    done = run_chromium((folder / "scene.html").as_uri() + hash, *options)
    return read_png(folder / "scene.png"), [line for line in done.stderr.splitlines() if "CONSOLE" in line]


def close_to(picture: np.ndarray, colour: str, within: int = 10) -> int:
    wanted = np.array(list(bytes.fromhex(colour[1:])))
    return int(np.count_nonzero(np.abs(picture.astype(int) - wanted).max(axis=2) <= within))


def test_a_browser_shows_machine_and_path(real: Kinematics, tmp_path: Path) -> None:
    text = scene_html(real, ring(real.machine, 8.0), title="ring", exaggeration=2000)
    picture, console = look(text, tmp_path)
    assert console == []
    assert picture.shape == (HEIGHT, WIDTH, 3)
    # The panel is 42 % of the window wide; the close-up between its heading and legend shows only the path.
    machine, closeup = (
        picture[90 : HEIGHT - 90, : int(0.56 * WIDTH)],
        picture[90 : HEIGHT - 270, int(0.58 * WIDTH) : -20],
    )
    for colour in VIRIDIS.values():
        assert close_to(closeup, colour, 20) > 20, colour
    assert close_to(closeup, "#d61a1f", 20) > 20  # the red arrow at the maximum
    red, green, blue = (machine[:, :, i].astype(int) for i in range(3))
    assert np.count_nonzero((blue > red + 40) & (blue > green + 25)) > 1500  # the blue bands
    assert np.count_nonzero(machine.max(axis=2) < 90) > 5000  # dark parts
    assert np.count_nonzero((machine.min(axis=2) > 90) & (machine.max(axis=2) < 225)) > 40_000  # shaded castings
    assert close_to(machine, VIRIDIS[0.5], 20) > 5  # the path on the machine, too


@pytest.mark.slow
def test_pixel_count_detects_an_empty_scene(real: Kinematics, tmp_path: Path) -> None:
    """Without deviation the path has one colour, and a failing script appears on the console."""
    text = scene_html(real, ring(real.machine, 0.0), title="ring")
    spoilt = text.replace("</body>", "<script>fetch('http://127.0.0.1:9/'); throw new Error('spoilt')</script></body>")
    picture, console = look(spoilt, tmp_path)
    closeup = picture[90 : HEIGHT - 270, int(0.58 * WIDTH) : -20]
    assert close_to(closeup, VIRIDIS[0.0]) > 40
    assert close_to(closeup, VIRIDIS[0.5], 20) == close_to(closeup, VIRIDIS[1.0], 20) == 0
    assert any("spoilt" in line for line in console)
    assert any("Content Security Policy" in line for line in console)


@pytest.mark.parametrize("program", ["cone_frustum.nc", "cone_frustum.h"])
def test_scene_and_account_name_the_same_worst_line(dmu50: Machine, program: str) -> None:
    """The largest error of the program as written, its line, and the RMS are those of the account."""
    account = twin.compensate(program, dmu50, options=twin.Options(tool_length_mm=120.0)).report.before
    run = execute_file(program, dmu50, Calibration.default(dmu50), tool_length_mm=120.0)
    path = ScenePath(run.positions, run.meant_mm, run.reached_mm, run.cutting, run.lines, run.gaps)
    assert path.lines[path.worst] == account.worst_line
    assert path.max_um == pytest.approx(account.max_um, rel=1e-6)
    drawn = path.drawn()
    assert len(drawn.lines) < len(path.lines) / 2 and set(drawn.lines) == set(path.lines)
    assert drawn.max_um == path.max_um and drawn.lines[drawn.worst] == path.lines[path.worst]
