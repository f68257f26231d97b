"""Calibration files: contents, round trip, and refusal of invalid files."""

from __future__ import annotations

import base64
import hashlib
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import beside
from tests.model.errors import random_calibration
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.numerics.covariance import Covariance
from twin.samples import dmu50_calibration

HEAD = "schema: twin.calibration/1\nmachine: DMU 50 eVolution\nsource: a test\n"


def test_default_calibration_gives_the_published_figure(dmu50: Machine) -> None:
    calibration = dmu50_calibration.as_drawn(dmu50)
    figure = beside("data", "figure-3-11.csv")
    rows = np.genfromtxt(
        [line for line in figure.read_text().splitlines() if not line.startswith("#")][1:], delimiter=","
    )
    x = rows[:, 0]
    for name, column in (("E_YX", 2), ("E_ZX", 3)):
        printed = [float(f"{-value * 1e-3:.6g}") for value in calibration.curves[name](x)]
        assert printed == list(rows[:, column])
        assert calibration.curves[name](0.0) == pytest.approx(0.0, abs=1e-12)
    assert np.abs(calibration.curves["E_XX"](x) - (x - rows[:, 1]) * 1e3).max() <= 0.5
    assert {"E_XX", "E_YX", "E_ZX"} == {c.name for c in calibration.curves.values() if not c.illustrative}


def test_default_calibration_equals_the_output_of_its_script(dmu50: Machine, calibration: Calibration) -> None:
    made = dmu50_calibration.calibration(dmu50)
    assert set(made.curves) == set(calibration.curves) == set(dmu50.motion_names)
    for name, curve in made.curves.items():
        # Least squares may differ in the last digits from one linear algebra library to another.
        assert curve.coefficients == pytest.approx(calibration.curves[name].coefficients, rel=1e-6, abs=2e-6)
    assert dict(made.squareness) == pytest.approx(dict(calibration.squareness), abs=2e-6)
    assert dict(made.location) == pytest.approx(dict(calibration.location), abs=2e-6)
    assert made.source == calibration.source and calibration.datum == "mean lines"
    published = {name for name, curve in calibration.curves.items() if curve.source.startswith("thesis figure 3.11")}
    assert published == {"E_XX", "E_YX", "E_ZX"}
    assert all("Datum changed to mean lines" in calibration.curves[name].source for name in published)


def test_drawn_curves_have_the_published_magnitudes(dmu50: Machine) -> None:
    calibration = dmu50_calibration.as_drawn(dmu50)
    for name, (peak, _) in dmu50_calibration.SHAPES.items():
        curve = calibration.curves[name]
        values = curve(np.linspace(*curve.domain, 2001))
        assert np.abs(values).max() == pytest.approx(abs(peak), rel=2e-3), name
    assert calibration.curves["E_AX"](300.0) == pytest.approx(-250.0)


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1))
def test_write_then_read(dmu50: Machine, tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    written = random_calibration(dmu50, np.random.default_rng(seed))
    path = tmp_path_factory.mktemp("calibration") / "c.yaml"
    written.save(path)
    again = Calibration.load(path, dmu50)
    assert again.curves.keys() == written.curves.keys()
    assert all(again.curves[name].coefficients == curve.coefficients for name, curve in written.curves.items())
    assert all(again.curves[name].domain == curve.domain for name, curve in written.curves.items())
    assert dict(again.squareness) == dict(written.squareness)
    assert dict(again.location) == dict(written.location)


CURVE = "curves:\n  E_XX:\n    unit: um\n    domain: [0, 500]\n    basis: power\n    coefficients: [1, 2]\n"


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("", None, "schema: twin.calibration/1"),
        ("schema: twin.machine/1\n", 1, "twin.calibration/1"),
        ("schema: twin.calibration/1\nmachine: Hermle\nsource: x\n", 2, "DMU 50 eVolution"),
        (HEAD + CURVE.replace("E_XX", "E_QX"), 5, "E_XX, E_YX"),
        (HEAD + CURVE.replace("unit: um", "unit: inch"), 6, "um"),
        (HEAD + CURVE.replace("[0, 500]", "[500, 0]"), 7, "lo < hi"),
        (HEAD + CURVE.replace("power", "wavelet"), 8, "power, fourier"),
        (HEAD + CURVE.replace("power", "fourier"), 9, "rotary"),
        (HEAD + CURVE.replace("[1, 2]", "[1, two]"), 9, "number"),
        (HEAD + CURVE.replace("[1, 2]", "[1, .nan]"), 9, "finite"),
        (HEAD + CURVE.replace("[1, 2]", "[]"), 9, "at least 1"),
        (HEAD + CURVE + "    covariance: [[1, 2], [2, 1]]\n", 10, "negative eigenvalue"),
        (HEAD + CURVE + "    covariance: [[1, 0]]\n", 10, "2 rows of 2"),
        (HEAD + CURVE + "    covariance: [[1, 0.5], [0, 1]]\n", 10, "symmetric"),
        (HEAD + CURVE + "    unit: um\n", 10, "each key once"),
        (HEAD + CURVE + "    colour: red\n", 10, "colour"),
        (HEAD + "squareness: {E_C0X: 10}\n", 4, "E_C0Y"),
        (HEAD + "squareness: {E_C0Y: 2e6}\n", 4, "100000"),
        (HEAD + "location: {E_Z0C: 10}\n", 4, "E_X0C"),
        (HEAD + "effects: [{effect: magic}]\n", 4, "magic"),
        (HEAD + CURVE.replace("E_XX", "E_ZC"), 7, "360 degrees"),
        (HEAD + "curves: [1, 2\n", 5, "YAML"),
    ],
)
def test_invalid_files_are_refused_with_file_line_and_reason(
    dmu50: Machine, tmp_path: Path, text: str, line: int | None, words: str
) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        Calibration.load(path, dmu50)
    assert caught.value.file == str(path)
    assert caught.value.line == line
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_covariance_is_kept(dmu50: Machine, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(HEAD + CURVE + "    covariance: [[1e-2, 1e-3], [1e-3, 4e-2]]\n")
    loaded = Calibration.load(path, dmu50)
    loaded.save(path)
    again = Calibration.load(path, dmu50).curves["E_XX"].covariance
    assert again is not None
    assert np.array_equal(again, [[1e-2, 1e-3], [1e-3, 4e-2]])


def test_a_curve_outside_its_domain_is_an_error(calibration: Calibration) -> None:
    with pytest.raises(InputError, match=r"E_XX outside its domain: .*500\.5.*0 to 500"):
        calibration.curves["E_XX"]([10.0, 500.5])


def test_not_a_text_file(dmu50: Machine, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match="UTF-8"):
        Calibration.load(path, dmu50)
    with pytest.raises(InputError, match="readable"):
        Calibration.load(tmp_path / "none.yaml", dmu50)


def test_joint_covariance_reads_back(dmu50: Machine, tmp_path: Path) -> None:
    rng = np.random.default_rng(31)
    drawn = random_calibration(dmu50, rng).where(lambda name: name in ("E_XX", "E_AY", "E_C0Y", "E_X0C"))
    names = tuple(p.name for effect in drawn.effects for p in effect.parameters)
    root = rng.normal(size=(len(names), len(names))) * np.exp(rng.normal(size=len(names)))[:, None]
    joint = Covariance(names, root @ root.T)
    path = tmp_path / "joint.yaml"
    replace(drawn, joint=joint).save(path)
    again = Calibration.load(path, dmu50)
    assert again.covariance.names == names
    assert np.array_equal(again.covariance.matrix, joint.matrix)
    assert again.without_uncertainty == ()
    part = again.where(lambda name: name == "E_AY").covariance
    assert part.names == tuple(name for name in names if name.startswith("E_AY"))
    assert drawn.without_uncertainty == ("E_XX", "E_AY", "E_C0Y", "E_X0C")


def _large(dmu50: Machine) -> Calibration:
    """Return a calibration with more parameters than are written as readable rows."""
    rng = np.random.default_rng(33)
    drawn = random_calibration(dmu50, rng).where(lambda name: name in ("E_XX", "E_YY", "E_ZZ", "E_AY", "E_XC", "E_C0Y"))
    names = tuple(p.name for effect in drawn.effects for p in effect.parameters)
    root = rng.normal(size=(len(names), len(names))) * np.exp(rng.normal(size=len(names)))[:, None]
    return replace(drawn, joint=Covariance(names, root @ root.T))


def test_a_large_joint_covariance_is_compressed_at_the_end(dmu50: Machine, tmp_path: Path) -> None:
    large = _large(dmu50)
    path = tmp_path / "large.yaml"
    large.save(path)
    text = path.read_text()
    assert "compressed: |" in text and "lower" not in text
    assert text.index("covariance:") > max(text.index("squareness:"), text.index("location:"))
    assert max(map(len, text[text.index("compressed: |") :].splitlines())) < 130
    again = Calibration.load(path, dmu50)
    assert again.covariance.names == large.covariance.names
    assert np.array_equal(again.covariance.matrix, large.covariance.matrix)
    assert again.to_yaml() == text
    # The format as the documentation states it, read without twin.
    entry = yaml.safe_load(text)["covariance"]
    grouped = zlib.decompress(base64.b64decode(entry["compressed"]))
    count = len(entry["parameters"])
    numbers = np.frombuffer(grouped, np.uint8).reshape(8, -1).T.copy().view("<f8").ravel()
    assert hashlib.sha256(numbers.tobytes()).hexdigest() == entry["sha256"]
    matrix = np.zeros((count, count))
    matrix[np.tril_indices(count)] = numbers
    assert np.array_equal(np.tril(large.covariance.matrix), matrix)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("compressed: |\n    ", "compressed: |\n    AAAA", "damaged|does not hold|SHA-256"),
        ("compressed: |\n    e", "compressed: |\n    é", "damaged"),
        ("sha256: ", "sha256: 0", "SHA-256"),
        ("parameters: [", "parameters: [E_A0Z, ", "not in this file"),
        ("  compressed: |", "  lower: '1'\n  compressed: |", "one of lower and compressed"),
    ],
)
def test_a_damaged_compressed_covariance_is_refused(
    dmu50: Machine, tmp_path: Path, old: str, new: str, words: str
) -> None:
    text = _large(dmu50).to_yaml()
    assert old in text
    path = tmp_path / "bad.yaml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=words):
        Calibration.load(path, dmu50)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("lower: |\n    ", "lower: |\n    1 ", "row 1 has 2 numbers"),
        ("- E_C0Y", "- E_A0Z", "not in this file"),
        ("lower: |\n    ", "lower: |\n    x", "not a number"),
        ("lower: |\n    ", "lower: |\n    -", "negative variance"),
    ],
)
def test_bad_joint_covariance_is_refused(dmu50: Machine, tmp_path: Path, old: str, new: str, words: str) -> None:
    drawn = random_calibration(dmu50, np.random.default_rng(32)).where(lambda name: name in ("E_XX", "E_C0Y"))
    names = tuple(p.name for effect in drawn.effects for p in effect.parameters)
    text = replace(drawn, joint=Covariance(names, np.eye(len(names)))).to_yaml()
    text = text.replace("E_C0Y]", "E_A0Z]") if old == "- E_C0Y" else text.replace(old, new)
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        Calibration.load(path, dmu50)


def test_derivatives_are_those_of_the_components(dmu50: Machine) -> None:
    """These effects are linear in their parameters: components are the sum of derivative times value."""
    drawn = random_calibration(dmu50, np.random.default_rng(33))
    drawn_q = np.random.default_rng(34).uniform([0, 0, -400, 0, -500], [500, 450, 0, 180, 500], (50, 5))
    q = dict(zip(dmu50.names, drawn_q.T, strict=True))
    for effect in drawn.effects:
        total = dict.fromkeys(effect.components(q), 0.0)
        for parameter, shape in zip(effect.parameters, effect.derivatives(q), strict=True):
            for i, values in shape.items():
                total[i] = total[i] + parameter.value * values
        for i, values in effect.components(q).items():
            np.testing.assert_allclose(total[i], values, rtol=1e-12, atol=1e-12)
