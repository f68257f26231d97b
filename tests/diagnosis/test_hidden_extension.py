"""A hidden pattern without a known cause extends the model with ``--empirical``, and programs compensated with it are cut better.

The truth machine (`tests.truth.hidden`, `tests.truth.machine`) shares no code with `twin`.
"""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.conftest import beside
from tests.diagnosis.test_hidden_unknown import stage_table
from tests.truth import hidden
from tests.truth.few_axes import write_stage
from tests.truth.hidden import Plan
from tests.truth.machine import AXES, TruthMachine
from twin import cli
from twin.compensation import Compensator, Options
from twin.diagnosis import Diagnosis, diagnose
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import Empirical
from twin.nc import dialect_for

SIGMA_MM = 3e-3
LENGTH = 120.0
WAY = np.array([0.5, -0.6, 0.62])
WARM = ("time_s", "T_X_degC", "T_Y_degC", "T_Z_degC", "T_bed_degC")
Shape = Callable[[np.ndarray, np.ndarray], np.ndarray]


def waves(q: np.ndarray, side: np.ndarray) -> np.ndarray:
    """(n,) µm: a product of short waves in X and Y."""
    return 20.0 * np.sin(5.3 * np.pi * q[:, 0] / 500.0 + 0.4) * np.sin(6.1 * np.pi * q[:, 1] / 450.0 + 1.0)


def lost_motion(q: np.ndarray, side: np.ndarray) -> np.ndarray:
    """(n,) µm: a reversal of Y, from −10 to +10 µm over Z."""
    return 10.0 * side[:, 1] * (q[:, 2] + 200.0) / 200.0


class Odd(TruthMachine):
    """The truth machine with a shift of the tool side that is in no catalogue."""

    def __init__(self, shape: Shape) -> None:
        super().__init__(hidden.CALIBRATION, LENGTH)
        self.shape = shape
        self.side = np.zeros(5)

    def errors(self, q: np.ndarray) -> dict[str, np.ndarray]:
        found = super().errors(q)
        found["X"][:3] += 1e-3 * self.shape(np.array([q]), self.side[None])[0] * WAY  # X carries the whole tool side
        return found

    def off(self, commands: np.ndarray, meant: np.ndarray) -> np.ndarray:
        """Return (n,) the deviation of the tool in µm, with approach directions from the previous commands."""
        found, self.side, last = [], np.zeros(5), commands[0]
        for q, wanted in zip(commands, meant, strict=True):
            step = np.where(np.abs(q - last) > 5e-3, np.sign(q - last), 0.0)
            self.side, last = np.where(step != 0.0, step, self.side), q
            found.append(np.linalg.norm(self.pose(q)[:3, 3] - self.pose(wanted, real=False)[:3, 3]) * 1e3)
        return np.array(found)


def measured(path: Path, shape: Shape | None, seed: int = 21) -> tuple[Plan, Path]:
    """Return a plan and its table with the hidden pattern."""
    of = hidden.rounded(hidden.plan(np.random.default_rng(seed), poses=140))

    def moved(plan: Plan) -> np.ndarray:
        on_tool = (plan.carrier == "tool")[:, None]
        return (
            1e-3
            * on_tool
            * (np.zeros((len(plan.q), 1)) if shape is None else shape(plan.q, plan.approach)[:, None] * WAY)
        )

    read = hidden.noisy(hidden.points(of, (), outside=moved), np.random.default_rng(9), "isotropic", SIGMA_MM)
    return of, hidden.write(path, of, read, u_mm=SIGMA_MM, without=WARM)


@dataclass(frozen=True)
class Diagnosed:
    """The files and the text that the command wrote."""

    json: dict
    calibration: Calibration
    text: str
    html: str

    @property
    def effect(self) -> Empirical:
        (one,) = self.calibration.empirical
        return one


def diagnosed(table: Path, machine: Machine, *more: str) -> Diagnosed:
    """Run `twin diagnose` and read all its outputs, written next to the table."""
    yaml, report, page = (table.with_suffix(suffix) for suffix in (".yaml", ".json", ".html"))
    words = ["diagnose", table, "--extended", yaml, "--json", report, "--html", page, *more]
    said = io.StringIO()
    with pytest.raises(SystemExit) as stopped, contextlib.redirect_stdout(said):
        cli.main([str(word) for word in words])
    assert not stopped.value.code
    text = " ".join(said.getvalue().split())
    return Diagnosed(json.loads(report.read_text()), Calibration.load(yaml, machine), text, page.read_text())


def program(seed: int) -> str:
    """Return a program of sixty blocks of all axes within the range, Y in both directions."""
    q = np.random.default_rng(seed).uniform([20, 20, -380, 10, 20], [480, 430, -20, 170, 340], (60, 5)).round(3)
    lines = ["G1 " + " ".join(f"{a}{v:.3f}" for a, v in zip(AXES, row, strict=True)) + " F500" for row in q]
    return "G21 G90\nG0 X100 Y100 Z-100 B30 C10\n" + "\n".join(lines) + "\nM30\n"


def cut(text: str, calibration: Calibration, truth: Odd) -> np.ndarray:
    """Return (blocks,) the deviation in µm at the end of each block of the compensated program on the truth machine."""
    dialect = dialect_for(Path("p.nc"))
    options = Options(tool_length_mm=LENGTH)
    done = Compensator(calibration.machine, calibration, options).compensate(
        dialect.read(text.encode(), "p.nc"), dialect
    )
    off = truth.off(done.commands, done.nominal)
    last = np.flatnonzero(np.append(np.diff(done.lines) != 0, True))
    return off[last][1:]


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Short waves on the tool side."""
    return measured(tmp_path_factory.mktemp("short") / "m.csv", waves)[1]


@pytest.fixture(scope="module")
def short(table: Path, dmu50: Machine) -> Diagnosed:
    return diagnosed(table, dmu50, "--empirical")


@pytest.mark.slow
def test_short_waves_extend_the_model_and_parts_are_cut_better(short: Diagnosed, calibration: Calibration) -> None:
    found = short
    assert found.json["verdict"] == "unexplained" and found.json["causes"] == []
    made = found.json["unexplained"]["extension"]
    assert (made["written"], made["reason"], made["where"]) == (True, None, "tool by X_mm, Y_mm")
    assert made["columns"] == ["X_mm", "Y_mm"] and made["ranges"] == {"X_mm": [0.0, 500.0], "Y_mm": [0.0, 450.0]}
    assert [term["where"] for term in made["terms"]] == ["tool by X_mm, Y_mm"]
    low, high = made["held_out"]["ci95_um"]
    assert 0.0 < low < made["held_out"]["rms_before_um"] - made["held_out"]["rms_after_um"] < high
    assert made["held_out"]["groups"] > 100
    assert found.effect.along == "base" and found.calibration.simulated is False

    # At positions that were not measured: the effect written against the hidden pattern, and against its stated uncertainty.
    rng = np.random.default_rng(3)
    fresh = np.stack([rng.uniform(0.0, 500.0, 400), rng.uniform(0.0, 450.0, 400)], axis=1)
    state = {"X": fresh[:, 0], "Y": fresh[:, 1]}
    hidden_um = waves(fresh, fresh)[:, None] * WAY
    apart = found.effect.shift(state) - hidden_um
    apart -= apart.mean(axis=0)  # where the targets sit takes up a constant
    # Two positions for each function: at most half of the pattern remains, and as much as stated.
    assert rms(apart) < 0.5 * rms(hidden_um - hidden_um.mean(axis=0))
    rates = found.effect.derivatives(state)
    names = [parameter.name for parameter in found.effect.parameters]
    columns = np.stack([np.stack([np.broadcast_to(rate.get(i, 0.0), 400) for i in range(3)], axis=1) for rate in rates])
    u = np.sqrt(
        np.einsum("pni,pq,qni->ni", columns, found.calibration.covariance.of(names).matrix, columns, optimize=True)
    )
    assert 0.5 < rms(apart / u) < 1.5

    # At the cutting points, compared with the calibration without it and with the stated gain.
    truth = Odd(waves)
    before, after = rms(cut(program(2), calibration, truth)), rms(cut(program(2), found.calibration, truth))
    said = found.json["gain"]["tool_point"]
    assert before > 8.0 and after < 0.5 * before
    assert 0.6 < before / said["before_um"] < 1.4 and 0.6 < after / said["after_um"] < 1.4


@pytest.mark.slow
def test_the_gain_is_that_of_the_file_written(short: Diagnosed, table: Path, dmu50: Machine) -> None:
    """A diagnosis with the file written has the stated residual and finds nothing more."""
    found = short
    gain = found.json["gain"]
    again = diagnose(Measurements.load(table, dmu50), dmu50, found.calibration)
    assert again.rms_um == pytest.approx(gain["rms_after_um"], rel=1e-3)
    assert gain["rms_before_um"] == pytest.approx(found.json["residual"]["rms_um"], rel=1e-9)
    assert again.verdict == "consistent" and again.rms_um == pytest.approx(1e3 * SIGMA_MM, rel=0.05)
    held = gain["held_out"]
    assert gain["rms_after_um"] < held["rms_after_um"] < 0.8 * held["rms_before_um"] and held["ci95_um"][0] > 0.0


@pytest.mark.slow
def test_the_text_states_the_limits_of_the_extension(short: Diagnosed, table: Path) -> None:
    for text in (short.text, " ".join(short.html.replace("&nbsp;", " ").split())):
        assert "without a known cause" in text and "outside them compensation is refused" in text
        assert "within X_mm 0 to 500 and Y_mm 0 to 450" in text and "held-out" in text
    written = " ".join(table.with_suffix(".yaml").read_text().split())
    assert "cause: unknown" in written and "Valid only inside these ranges" in written


@pytest.mark.slow
def test_without_the_option_the_calibration_is_not_extended(
    short: Diagnosed, table: Path, dmu50: Machine, calibration: Calibration, tmp_path: Path
) -> None:
    own = tmp_path / "m.csv"
    own.write_bytes(table.read_bytes())
    found = diagnosed(own, dmu50)
    assert found.json["unexplained"]["extension"] is None and found.json["gain"] is None
    # The errors are those of before; what the diagnosis says of them stands in the file.
    written = yaml.safe_load(found.calibration.to_yaml())
    assert found.calibration.extra == () and "systematic" in str(written.pop("misfit"))
    assert {key: written[key] for key in written.keys() - {"instruments", "set_up"}} == yaml.safe_load(
        calibration.to_yaml()
    )
    assert "xtended:" not in found.text
    with_it = dict(short.json["unexplained"], extension=None)
    assert found.json["unexplained"] == with_it and found.json["residual"] == short.json["residual"]


def test_the_option_needs_a_file_to_write(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.main(["diagnose", str(table), "--empirical"])
    assert stopped.value.code == 2 and "--extended" in capsys.readouterr().err


@pytest.mark.slow
def test_a_reversal_that_depends_on_the_position(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    """The approach direction of Y follows from the previous commands of the program."""
    _, own = measured(tmp_path / "m.csv", lost_motion)
    found = diagnosed(own, dmu50, "--empirical")
    made = found.json["unexplained"]["extension"]
    assert made["written"] and made["columns"] == ["approach_Y", "Z_mm"] and set(made["ranges"]) == {"Z_mm"}
    truth = Odd(lost_motion)
    before, after = rms(cut(program(4), calibration, truth)), rms(cut(program(4), found.calibration, truth))
    assert before > 4.0 and after < 0.4 * before


def refused(found: Diagnosis, calibration: Calibration) -> str:
    """Check that no empirical effect was written, and return the reason."""
    left = found.unexplained
    assert left is not None and left.extension is not None and not left.extension.written
    assert found.extended.empirical == () and calibration.empirical == ()
    reason = str(left.extension.reason)
    assert left.extension.to_dict()["reason"] == reason and f"is not in the extended calibration: {reason}" in " ".join(
        found.to_text().split()
    )
    return reason


@pytest.mark.slow
def test_a_pattern_of_time_is_not_written(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    """A later program does not know the time of the measurement."""
    of = hidden.rounded(hidden.plan(np.random.default_rng(5), poses=60))

    def moved(plan: Plan) -> np.ndarray:
        wave = np.sin(6.0 * np.pi * plan.time_s / plan.time_s.max())
        return 0.01 * (wave * (plan.carrier == "tool"))[:, None] * WAY

    read = hidden.noisy(hidden.points(of, (), outside=moved), np.random.default_rng(9), "isotropic", SIGMA_MM)
    table = hidden.write(tmp_path / "m.csv", of, read, u_mm=SIGMA_MM, without=WARM[1:])
    found = diagnose(Measurements.load(table, dmu50), dmu50, calibration, empirical=True)
    assert found.unexplained is not None and set(found.unexplained.depends_on) <= {"time_s", "round"}
    reason = refused(found, calibration)
    assert "which a later program does not know" in reason and "time_s" in reason


@pytest.mark.parametrize(("places", "why"), [(5, "too few to confirm"), (9, "do not confirm it")])
def test_a_pattern_refuted_by_held_out_positions_is_not_written(tmp_path: Path, places: int, why: str) -> None:
    """A random reversal at each position repeats there, but does not predict other positions."""
    machine = Machine.load(write_stage(tmp_path))
    calibration = Calibration.zero(machine)
    positions = np.linspace(0.0, 500.0, places)
    rough = np.random.default_rng(12).normal(size=places) * 8.0
    table = stage_table(tmp_path / "m.csv", positions, np.zeros(places), 0.0, 0.6)
    rows = [line.split(",") for line in table.read_text().splitlines()]
    for row in rows[1:]:
        row[4] = str(float(row[4]) + 1e-3 * float(row[1]) * rough[int(np.argmin(np.abs(positions - float(row[0]))))])
    table.write_text("\n".join(",".join(row) for row in rows) + "\n")
    found = diagnose(Measurements.load(table, machine), machine, calibration, empirical=True)
    assert why in refused(found, calibration)


def test_data_without_an_error_extend_nothing(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    _, table = measured(tmp_path / "m.csv", None)
    found = diagnose(Measurements.load(table, dmu50), dmu50, calibration, empirical=True)
    assert found.verdict == "consistent" and found.unexplained is None and found.extended.source == calibration.source


@pytest.mark.slow
def test_a_real_plate_gains_at_held_out_poses() -> None:
    """A drilled plate of 2003: besides its named causes, a fifth of the excess depends on X and Y."""
    machine = Machine.load(beside("data", "real", "plate-2003", "drill.yaml"))
    data = Measurements.load(beside("data", "real", "plate-2003", "plate.csv"), machine)
    plain, found = (diagnose(data, machine, Calibration.default(machine), empirical=own) for own in (False, True))
    left = found.unexplained
    assert left is not None and left.extension is not None and left.extension.written
    assert set(left.extension.ranges) == {"X_mm", "Y_mm"} and found.causes[0].effect == plain.causes[0].effect
    assert plain.gain is not None and plain.gain.held_out is not None
    assert found.gain is not None and found.gain.held_out is not None
    without, with_it = plain.gain.held_out, found.gain.held_out
    assert without.before_um == with_it.before_um and with_it.after_um < 0.95 * without.after_um
    assert found.gain.rms_after_um < plain.gain.rms_after_um < found.gain.rms_before_um
