"""The linearity of a sensor that reads one coordinate: it is confounded with the axis's positioning until the sensor is shifted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.truth.few_axes import write_stage
from twin.diagnosis import Diagnosis, diagnose
from twin.diagnosis.answer import diagnosis_text
from twin.machine.machine import Machine
from twin.measurement.instruments import LinearInterferometer
from twin.measurement.instruments.base import Instrument
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

SENSOR, AXIS = ("sensor_linearity", "—"), ("positioning", "E_XX")
Curve = Callable[[np.ndarray], np.ndarray]


def bent(share: np.ndarray) -> np.ndarray:
    """Return an S-shaped deviation, ±1, over −1 to 1."""
    return 2.6 * (share**3 - share)


def flat(share: np.ndarray) -> np.ndarray:
    return np.zeros(len(share))


@pytest.fixture
def look(tmp_path: Path) -> Callable[..., Diagnosis]:
    """Simulate runs of a slide from 200 to 230 mm, read by one sensor at one or two places, and diagnose them."""
    machine = Machine.load(str(write_stage(tmp_path)))

    def looked(
        sensor: Curve,
        axis: Curve,
        shifts: tuple[float, ...] = (0.0,),
        *,
        size_um: float = 15.0,
        sigma_um: float = 0.5,
        named: str = "",
        instrument: Instrument | None = None,
        seed: int = 3,
    ) -> Diagnosis:
        rng = np.random.default_rng(seed)
        lines = ["X_mm,approach_X,target,carrier,station,x_mm,y_mm,z_mm,round" + (",instrument" if named else "")]
        for number, shift in enumerate(shifts):
            for run in range(4):
                stops = np.linspace(200.0, 230.0, 25)
                for x in stops if run % 2 == 0 else stops[::-1]:
                    true = x + 1e-3 * size_um * float(axis(np.array([(x - 215.0) / 15.0]))[0])
                    off = (
                        size_um * float(sensor(np.array([(x - 215.0 + shift) / 20.0]))[0])
                        + sigma_um * rng.standard_normal()
                    )
                    lines.append(
                        f"{x},{1 - 2 * (run % 2)},slide,tool,s{number},{true + shift + 1e-3 * off:.7f},,,{run + 1}"
                        + (f",{named}" if named else "")
                    )
        path = tmp_path / "run.csv"
        path.write_text("\n".join(lines) + "\n")
        return diagnose(Measurements.load(path, machine), machine, Calibration.default(machine), instrument=instrument)

    return looked


def group(result: Diagnosis) -> set[tuple[str, str]]:
    """Return the cause and what it is confounded with."""
    (cause,) = result.causes
    return {(cause.effect, cause.where), *cause.equivalent}


@pytest.mark.parametrize("whose", [(bent, flat), (flat, bent)], ids=["sensor", "axis"])
def test_at_one_place_both_are_named(look: Callable[..., Diagnosis], whose: tuple[Curve, Curve]) -> None:
    result = look(*whose)
    assert result.verdict == "ambiguous" and {SENSOR, AXIS} <= group(result)
    text = " ".join(diagnosis_text(result).split())
    assert "shift the sensor by a quarter of the range" in text.lower()
    assert "Service" not in text and "guideway" not in text


def test_a_shifted_sensor_shows_that_it_is_the_sensor(look: Callable[..., Diagnosis]) -> None:
    result = look(bent, flat, (0.0, 7.0))
    assert group(result) == {SENSOR} and result.verdict == "explained"
    (size,) = result.causes[0].parameters
    x = np.linspace(-15.0, 22.0, 401) / 20.0
    truth = 15.0 * (bent(x) - bent(x).mean())
    assert abs(size.value - np.abs(truth).max()) < 3.0 * size.u
    assert result.extended.source == result.calibration.source


def test_a_shifted_sensor_shows_that_it_is_the_axis(look: Callable[..., Diagnosis]) -> None:
    assert group(look(flat, bent, (0.0, 7.0))) == {AXIS}


def test_a_curve_over_a_small_part_of_the_travel_is_one(look: Callable[..., Diagnosis]) -> None:
    """Over 30 of 500 mm: it is not taken for a step with a wave, although beyond these positions the curve may be any size."""
    result = look(flat, bent, named="linear-interferometer")
    assert group(result) == {AXIS}


@pytest.mark.parametrize(
    "how", [{"named": "linear-interferometer"}, {"instrument": LinearInterferometer()}], ids=["table", "option"]
)
def test_an_instrument_that_is_named_has_no_such_error(look: Callable[..., Diagnosis], how: dict[str, object]) -> None:
    assert SENSOR not in group(look(flat, bent, **how))


@pytest.mark.parametrize("seed", [4, 6, 7])
def test_nothing_is_named_without_it(look: Callable[..., Diagnosis], seed: int) -> None:
    assert look(flat, flat, seed=seed).verdict == "consistent"


def test_below_the_least_increment_nothing_is_advised(look: Callable[..., Diagnosis]) -> None:
    """20 nm on an axis of 1 µm."""
    result = look(flat, bent, size_um=0.02, sigma_um=0.001)
    assert result.causes and all(not cause.promised and cause.below_increment for cause in result.causes)
    text = " ".join(diagnosis_text(result).split())
    assert "below the least increment of the axes" in text
    assert "Service" not in text and "service" not in text and "Compensate" not in text
    assert result.extended.source == result.calibration.source
