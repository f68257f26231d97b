"""A truth machine with hidden effects: the DMU 50 measured by a realistic plan, in plain numpy, sharing no code with `twin`.

Single-axis runs back and forth, poses of all five axes, three targets on either side, three rounds, time, temperatures and the
direction of approach of each axis. Effects are written from their definitions in the documentation; mm and radians inside.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import yaml

from tests.truth.machine import AXES, RANGES
from tests.truth.reference import D

HERE = Path(__file__).resolve().parents[2]
CALIBRATION = HERE / "urdf" / "dmu50.calibration.yaml"
LOW, HIGH = np.array([RANGES[a][0] for a in AXES]), np.array([RANGES[a][1] for a in AXES])
HOME = np.array([250.0, 225.0, -200.0, 0.0, 0.0])
STEP_S = 8.0
G = 9.81
MASSES = {"cradle": (260.0, (0.0, -0.15, -0.24)), "table": (120.0, (0.0, 0.0, -0.032))}
"""kg, and the centre in the link's frame, m, of everything that rotates with B, from the URDF."""
TARGETS = {
    "K": ("tool", (-100.0, 70.0, 180.0)),
    "P": ("tool", (30.0, -70.0, 10.0)),
    "Q": ("tool", (110.0, 60.0, 150.0)),
    "T": ("work", (-60.0, 130.0, 170.0)),
    "U": ("work", (-100.0, -200.0, 30.0)),
    "V": ("work", (60.0, 90.0, 140.0)),
}
STATIONS = {"1": ((0.0, -2000.0, 200.0), (0.0, 0.0, 1.6)), "2": ((1900.0, -300.0, 700.0), (0.1, -0.2, 3.0))}


@dataclass(frozen=True)
class Plan:
    """Rows of the measurement in order: n of them."""

    q: np.ndarray
    approach: np.ndarray
    target: np.ndarray
    station: np.ndarray
    round: np.ndarray
    time_s: np.ndarray
    warm: dict[str, np.ndarray]
    readback: np.ndarray | None = None
    spindle_rpm: np.ndarray | None = None
    load_kg: np.ndarray | None = None

    def at(self, axis: str) -> np.ndarray:
        return self.q[:, AXES.index(axis)]

    @property
    def carrier(self) -> np.ndarray:
        return np.array([TARGETS[name][0] for name in self.target])


@dataclass(frozen=True)
class Hidden:
    """One named effect at one place."""

    effect: str
    where: str
    numbers: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> tuple[str, str]:
        return self.effect, self.where


def plan(
    rng: np.random.Generator,
    *,
    rounds: int = 3,
    stops: int = 11,
    poses: int = 140,
    stations: int = 1,
    same: bool = True,
) -> Plan:
    """Return runs of each axis back and forth, then poses of all axes; ``same`` in every round, or new ones."""
    q, target, number = [], [], []
    drawn = rng.uniform(LOW, HIGH, (poses, 5))
    names = list(TARGETS)
    for k in range(rounds):
        for axis in range(5):
            places = np.linspace(LOW[axis], HIGH[axis] - (20.0 if axis == 4 else 0.0), stops)
            # A run begins a little outside, so that the first stop is approached from that side.
            for run in (places, places[::-1]):
                for j, place in enumerate(run):
                    for i in (0, 1):
                        pose = HOME.copy()
                        pose[axis] = place
                        q.append(pose)
                        target.append(names[(0 if axis < 3 else 3) + (j + i) % 3])
                        number.append(k + 1)
        if not same and k > 0:
            drawn = rng.uniform(LOW, HIGH, (poses, 5))
        for j in range(poses):
            for i in (0, 3):
                q.append(drawn[j])
                target.append(names[i + j % 3])
                number.append(k + 1)
    positions = np.round(np.array(q), 3)
    n = len(positions)
    approach = np.ones((n, 5))
    for i in range(1, n):
        moved = np.sign(positions[i] - positions[i - 1])
        approach[i] = np.where(moved != 0.0, moved, approach[i - 1])
    per_run = 2 * stops
    for k in range(rounds):
        for axis in range(5):
            start = k * (n // rounds) + axis * 2 * per_run
            approach[start : start + per_run, axis] = 1.0
            approach[start + per_run : start + 2 * per_run, axis] = -1.0
        # Every round begins by homing all axes from below: repeats have the same approach.
        first = k * (n // rounds)
        for i in range(first, first + n // rounds):
            axis = (i - first) // (2 * per_run)
            if axis < 5:
                others = [a for a in range(5) if a != axis]
                approach[i, others] = 1.0
    time = STEP_S * np.arange(n)
    warm = {
        a: 20.0 + 3.0 * rng.uniform(0.5, 1.0) * (1.0 - np.exp(-time / 6000.0)) + 0.3 * np.sin(time / 3000.0 + 2.0 * i)
        for i, a in enumerate("XYZ")
    }
    warm["bed"] = 20.0 + 1.5 * np.sin(time / 2500.0 + 1.0)
    station = np.array([str(1 + (i // 2) % stations) for i in range(n)])
    return Plan(positions, approach, np.array(target), station, np.array(number).astype(str), time, warm)


def points(
    of: Plan,
    hidden: Sequence[Hidden] = (),
    *,
    outside: Callable[[Plan], np.ndarray] | None = None,
    calibration: Path = CALIBRATION,
    elsewhere: Mapping[str, str] | None = None,
) -> np.ndarray:
    """Return (n, 3) the readings of a perfect instrument, mm.

    Args:
        of: the plan.
        hidden: the effects.
        outside: (n, 3) a shift of the target in the base, mm, that is in no catalogue.
        calibration: errors that are known.
        elsewhere: axis → where its errors act instead of at its own joint: another axis, or ``base``.
    """
    n = len(of.q)
    error = {name: np.zeros((n, 6)) for name in ("X", "Y", "Z", "B", "C", "L_B", "L_C")}
    entries = _parsed(calibration.read_text())
    for name, entry in entries.get("curves", {}).items():
        _component(error, name)[:] += _size(name) * _curve(entry, of.at(name[3]))
    square = {name: 0.0 for name in ("E_C0Y", "E_B0Z", "E_A0Z")} | dict(entries.get("squareness", {}))
    located = dict(entries.get("location", {}))
    place = np.array([TARGETS[name][1] for name in of.target])
    moved = np.zeros((n, 3)) if outside is None else outside(of)
    on_tool = (of.carrier == "tool").astype(float)
    for h in hidden:
        v, axis = h.numbers, h.where
        if h.effect == "reversal":
            _along(error, axis, 0.5 * v["size"] * of.approach[:, AXES.index(axis)])
        elif h.effect == "reversal_curve":
            lo, hi = RANGES[axis]
            u = (2 * of.at(axis) - lo - hi) / (hi - lo)
            size = sum(v[name] * u ** int(name[1:]) for name in v)
            _along(error, axis, 0.5 * size * of.approach[:, AXES.index(axis)])
        elif h.effect == "pitch_error":
            _along(error, axis, v["amplitude"] * np.sin(2 * np.pi * of.at(axis) / v["period"] + v["phase"]))
        elif h.effect == "squareness":
            square[h.where] += v["angle"]
        elif h.effect == "axis_location":
            located[h.where] = located.get(h.where, 0.0) + v["offset"]
        elif h.effect in ("positioning", "straightness", "angular_error_motion"):
            lo, hi = RANGES[h.where[3]]
            u = (2 * of.at(h.where[3]) - lo - hi) / (hi - lo)
            _component(error, h.where)[:] += _size(h.where) * sum(v[name] * u ** int(name[1:]) for name in v)
        elif h.effect == "harmonic":
            angle = v["order"] * np.radians(of.at(h.where[3]))
            _component(error, h.where)[:] += _size(h.where) * (v["cos"] * np.cos(angle) + v["sin"] * np.sin(angle))
        elif h.effect == "thermal_expansion":
            _along(error, axis, v["coefficient"] * (of.warm[axis] - 20.0) * of.at(axis) * 1e-3)
        elif h.effect == "scale_growth":
            own = v["coefficient"] * of.at(axis) * 1e-3 + v["offset"]
            _along(error, axis, own * (of.warm[axis] - 20.0))
        elif h.effect == "scale_drift":
            hours = of.time_s / 3600.0
            course = hours if "rate" in v else 1.0 - np.exp(-of.time_s / v["time_constant"])
            slope, offset = (v["rate"], v["offset_rate"]) if "rate" in v else (v["amplitude"], v["offset"])
            _along(error, axis, (slope * of.at(axis) * 1e-3 + offset) * course)
        elif h.effect == "scale_step":
            low = v["place"] - v.get("width", 0.0) / 2.0
            rise = (of.at(axis) - low) / v["width"] if "width" in v else (of.at(axis) >= v["place"]).astype(float)
            _along(error, axis, v["size"] * np.clip(rise, 0.0, 1.0))
        elif h.effect == "thermal_tilt":
            name, sensor = h.where.split(" by ")
            turned = v["coefficient"] * (of.warm[sensor] - 20.0)
            if name[3] == "0":
                error[f"L_{name[4]}"][:, "XYZABC".index(name[2])] += 1e-6 * turned
            else:
                _component(error, name)[:] += 1e-6 * turned
        elif h.effect == "thermal_lag":
            direction, sensor = h.where.split(" by ")
            moved[:, "XYZ".index(direction)] += (
                on_tool * 1e-3 * v["coefficient"] * follows(of, sensor, v["time_constant"])
            )
        elif h.effect == "thermal_growth":
            direction, sensor = h.where.split(" by ")
            moved[:, "XYZ".index(direction)] += on_tool * v["coefficient"] * 1e-3 * (of.warm[sensor] - 20.0)
        elif h.effect == "thermal_drift":
            if "rate" in v:
                creep = v["rate"] * of.time_s / 3600.0
            else:
                creep = v["amplitude"] * (1.0 - np.exp(-of.time_s / v["time_constant"]))
            moved[:, "XYZ".index(h.where)] += on_tool * 1e-3 * creep
        elif h.effect == "spindle_growth":
            drive = (of.spindle_rpm / of.spindle_rpm.max()) ** v["exponent"]
            moved[:, "XYZ".index(h.where)] += (
                on_tool * 1e-3 * v["amplitude"] * lagged(of.time_s, drive, v["time_constant"])
            )
        elif h.effect == "cross_axis":
            name, by = h.where.split(" by ")
            own = of.at(name[3]) * 1e-3 if name[2] in "XYZ" else 1.0
            _component(error, name)[:] += _size(name) * v["coefficient"] * own * of.at(by) * 1e-3
        elif h.effect == "table_load":
            moment = 1.0 if "load_z" not in v else 1.0 + _quarter(of, v)
            error["B"][:, 3] += v["tilt"] * moment * 1e-6 * np.sin(np.radians(of.at("B")))
        elif h.effect == "gravity_compliance":
            _along(
                error,
                axis,
                v["compliance"] * (_load(of, axis) + (_carried_load(of, axis, v) if "load_z" in v else 0.0)),
            )
        elif h.effect == "zero_offset":
            _along(error, axis, v["offset"])
        elif h.effect == "following_error":
            off = (of.readback - of.q)[:, AXES.index(axis)]
            _along(error, axis, off * (1e3 if axis in "XYZ" else 1e6 * np.pi / 180.0))
        elif h.effect == "target_shift":
            name, number = h.where.split(" from round ")
            mask = (of.target == name) & (of.round.astype(int) >= int(number))
            place = place + mask[:, None] * 1e-3 * np.array([v[f"shift_{a}"] for a in "xyz"])
    error["Y"][:, 0] -= of.at("Y") * square["E_C0Y"] * 1e-6
    error["Z"][:, 0] += of.at("Z") * square["E_B0Z"] * 1e-6
    error["Z"][:, 1] -= of.at("Z") * square["E_A0Z"] * 1e-6
    for name, value in located.items():
        error[f"L_{name[4]}"][:, "XYZABC".index(name[2])] += _size(name) * value
    before = {"tool": np.zeros((n, 6)), "work": np.zeros((n, 6))}
    for axis, other in (elsewhere or {}).items():
        target = before["tool" if axis in "XYZ" else "work"] if other == "base" else error[other]
        target += error[axis]
        error[axis] = np.zeros((n, 6))
    base = _carried(of, error, place)
    for side, own in before.items():
        rows = (of.carrier == side)[:, None]
        base = np.where(rows, own[:, :3] + np.einsum("nij,nj->ni", _exp(own[:, 3:]), base), base)
    base = base + moved
    return read(of, base, hidden)


def lagged(time_s: np.ndarray, drive: np.ndarray, constant: float) -> np.ndarray:
    """Return (n,) the first-order lag of an input held from the row before on: its convolution with an exponential."""
    ends, begins = time_s[:, None] - time_s, time_s[:, None] - np.concatenate([[0.0], time_s[:-1]])
    past = np.exp(-np.maximum(ends, 0.0) / constant) - np.exp(-np.maximum(begins, 0.0) / constant)
    return np.where(ends >= 0.0, past, 0.0) @ drive


def follows(of: Plan, sensor: str, constant: float) -> np.ndarray:
    """Return (n,) T − 20 °C behind a lag, from the first row on in equilibrium; steps of a second between the rows."""
    fine = np.arange(of.time_s[0], of.time_s[-1] + 1.0)
    level = np.interp(fine, of.time_s, of.warm[sensor] - 20.0)
    found = np.empty_like(level)
    found[0] = level[0]
    share = 1.0 - np.exp(-1.0 / constant)
    for i in range(1, len(fine)):
        found[i] = found[i - 1] + share * (0.5 * (level[i] + level[i - 1]) - found[i - 1])
    return np.interp(of.time_s, fine, found)


def read(of: Plan, base: np.ndarray, hidden: Sequence[Hidden]) -> np.ndarray:
    """Return (n, 3) the stations' readings of points (n, 3) of the base, with the hidden errors of the instrument, mm."""
    origin = np.array([STATIONS[name][0] for name in of.station])
    turn = np.array([STATIONS[name][1] for name in of.station])
    for h in hidden:
        if h.effect == "station_drift":
            hours = (of.time_s - of.time_s.min()) / 3600.0 * (of.station == h.where)
            if "time_constant" in h.numbers:
                constant = h.numbers["time_constant"] / 3600.0
                hours = constant * (1.0 - np.exp(-hours / constant))
            origin = origin + hours[:, None] * 1e-3 * np.array([h.numbers[f"rate_{a}"] for a in "xyz"])
    seen = np.einsum("nji,nj->ni", _exp(turn), base - origin)
    for h in hidden:
        v = h.numbers
        if h.effect == "frame_shift":
            number, _, only = h.where.split("round ")[1].partition(" ")
            rounds = of.round.astype(int)
            mask = (rounds == int(number) if only else rounds >= int(number))[:, None]
            turned = np.einsum("nij,nj->ni", _exp(mask * 1e-6 * np.array([v[f"turn_{a}"] for a in "xyz"])), seen)
            seen = turned + mask * 1e-3 * np.array([v[f"shift_{a}"] for a in "xyz"])
        elif h.effect == "refraction_scale":
            seen = seen * (1.0 + v["scale"] * 1e-6)
        elif h.effect == "affine_scale":
            kind, name = h.where.split(" ")
            mask = of.station == name if kind == "station" else of.round == name
            shears = np.array([[0.0, v["shear_xy"], v["shear_xz"]], [0.0, 0.0, v["shear_yz"]], [0.0] * 3])
            strain = 1e-6 * (np.diag([v["scale_x"], v["scale_y"], v["scale_z"]]) + 0.5 * (shears + shears.T))
            # A station is rotated about its origin; in a round the instrument was realigned, about the middle of its readings.
            middle = np.zeros(3) if kind == "station" else seen[mask].mean(axis=0)
            seen = seen + mask[:, None] * ((seen - middle) @ strain)
    return seen


def set_up(of: Plan) -> np.ndarray:
    """Return (3n, columns) the change of the readings by shift and rotation of each station and shift of each target."""
    n = len(of.q)
    none = {name: np.zeros((n, 6)) for name in ("X", "Y", "Z", "B", "C", "L_B", "L_C")}
    base = _carried(of, none, np.array([TARGETS[name][1] for name in of.target]))
    origin = np.array([STATIONS[name][0] for name in of.station])
    into = _exp(np.array([STATIONS[name][1] for name in of.station])).transpose(0, 2, 1)
    columns = []
    for direction in np.eye(3):
        along = np.broadcast_to(direction, (n, 3))
        for names, moved in (
            (of.target, turned(of, along)),
            (of.station, along),
            (of.station, np.cross(along, base - origin)),
        ):
            seen = np.einsum("nij,nj->ni", into, moved)
            columns += [seen * (names == name)[:, None] for name in np.unique(names)]
    return np.stack(columns, axis=2).reshape(3 * n, -1)


def turned(of: Plan, vectors: np.ndarray) -> np.ndarray:
    """Return (n, 3) in the base: vectors (n, 3) that are fixed to the side of each row's target, without errors."""
    none = {name: np.zeros((len(of.q), 6)) for name in ("X", "Y", "Z", "B", "C", "L_B", "L_C")}
    return _carried(of, none, vectors) - _carried(of, none, np.zeros((len(of.q), 3)))


def left_over(of: Plan, moved: np.ndarray, kind: str = "isotropic", sigma_mm: float = 3e-3) -> np.ndarray:
    """Return (3n, k) changes of the readings in standard deviations of their noise, without what the set-up absorbs of them.

    Args:
        of: the plan.
        moved: (n, 3, k) changes of the readings, mm.
        kind: of noise, as in `noisy`.
        sigma_mm: of isotropic noise.
    """
    n = len(of.q)
    weight = np.broadcast_to(np.eye(3) / sigma_mm, (n, 3, 3))
    if kind == "tracker":
        read = points(of)
        metres = np.linalg.norm(read, axis=1)[:, None, None] * 1e-3
        beam = read / np.linalg.norm(read, axis=1, keepdims=True)
        along = beam[:, :, None] * beam[:, None, :]
        weight = 1e3 * (along / (0.2 + 0.15 * metres) + (np.eye(3) - along) / (7.5 + 3.0 * metres))
    absorbed = (weight @ set_up(of).reshape(n, 3, -1)).reshape(3 * n, -1)
    absorbed = absorbed / np.linalg.norm(absorbed, axis=0)
    change = (weight @ moved).reshape(3 * n, -1)
    return change - absorbed @ (np.linalg.pinv(absorbed.T @ absorbed, rcond=1e-10) @ (absorbed.T @ change))


def noisy(read: np.ndarray, rng: np.random.Generator, kind: str, sigma_mm: float = 3e-3) -> np.ndarray:
    """Return readings with noise: isotropic, or as a tracker's: 0.4 + 0.3/m µm along, 15 + 6/m µm across, two sigma."""
    white = rng.standard_normal(read.shape)
    if kind == "isotropic":
        return read + sigma_mm * white
    length = np.linalg.norm(read, axis=1, keepdims=True)
    beam = read / length
    along = np.sum(white * beam, axis=1, keepdims=True) * beam
    metres = length * 1e-3
    return read + 1e-3 * ((0.2 + 0.15 * metres) * along + (7.5 + 3.0 * metres) * (white - along))


def write(path: Path, of: Plan, read: np.ndarray, *, u_mm: float | None, without: Sequence[str] = ()) -> Path:
    """Write the measurement table."""
    columns: dict[str, np.ndarray] = {f"{a}_{'mm' if a in 'XYZ' else 'deg'}": of.at(a) for a in AXES}
    if of.readback is not None:
        columns |= {f"readback_{a}_{'mm' if a in 'XYZ' else 'deg'}": of.readback[:, i] for i, a in enumerate(AXES)}
    columns |= {
        "target": of.target,
        "carrier": of.carrier,
        "station": of.station,
        "round": of.round,
        "time_s": of.time_s,
    }
    if of.spindle_rpm is not None:
        columns["spindle_rpm"] = of.spindle_rpm
    if of.load_kg is not None:
        columns["load_kg"] = of.load_kg
    columns |= {f"approach_{a}": of.approach[:, i].astype(int) for i, a in enumerate(AXES)}
    columns |= {f"T_{name}_degC": np.round(values, 3) for name, values in of.warm.items()}
    columns |= {f"{c}_mm": read[:, i] for i, c in enumerate("xyz")}
    if u_mm is not None:
        columns |= {f"u_{c}_mm": np.full(len(read), u_mm) for c in "xyz"}
    kept = {name: values for name, values in columns.items() if name not in without}
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(kept)
        writer.writerows(zip(*(values.tolist() for values in kept.values()), strict=True))
    return path


def rounded(of: Plan) -> Plan:
    """Return the plan with temperatures as they are written in the table."""
    return replace(of, warm={name: np.round(values, 3) for name, values in of.warm.items()})


@lru_cache(maxsize=16)
def _parsed(text: str) -> dict:
    """Return the content of a calibration, read-only."""
    return dict(yaml.safe_load(text))


def _size(name: str) -> float:
    return 1e-3 if name[2] in "XYZ" else 1e-6


def _component(error: dict[str, np.ndarray], name: str) -> np.ndarray:
    return error[name[3]][:, "XYZABC".index(name[2])]


def _along(error: dict[str, np.ndarray], axis: str, value: np.ndarray | float) -> None:
    """Return µm or µrad along the axis's command: C is commanded about its frame's −z."""
    column, scale = {"X": (0, 1e-3), "Y": (1, 1e-3), "Z": (2, 1e-3), "B": (5, 1e-6), "C": (5, -1e-6)}[axis]
    error[axis][:, column] += scale * value


def _curve(entry: dict, q: np.ndarray) -> np.ndarray:
    c = [float(value) for value in entry["coefficients"]]
    if entry["basis"] == "fourier":
        total = np.full(len(q), c[0])
        for k in range(1, (len(c) + 1) // 2):
            total += c[2 * k - 1] * np.cos(k * np.radians(q)) + c[2 * k] * np.sin(k * np.radians(q))
        return total
    lo, hi = entry["domain"]
    return np.polyval(c[::-1], (2 * q - lo - hi) / (hi - lo))


def _exp(w: np.ndarray) -> np.ndarray:
    """Return (n, 3, 3) rotations by Rodrigues' formula."""
    angle = np.linalg.norm(w, axis=1)
    safe = np.maximum(angle, 1e-300)
    n = w / safe[:, None]
    zero = np.zeros(len(w))
    k = np.stack([zero, -n[:, 2], n[:, 1], n[:, 2], zero, -n[:, 0], -n[:, 1], n[:, 0], zero], axis=1).reshape(-1, 3, 3)
    half = 2.0 * np.sin(angle / 2.0) ** 2
    return np.eye(3) + np.sin(angle)[:, None, None] * k + half[:, None, None] * k @ k


def _rz(angle: np.ndarray) -> np.ndarray:
    return _exp(np.stack([0 * angle, 0 * angle, angle], axis=1))


def _rx(n: int, angle: float) -> np.ndarray:
    return _exp(np.tile([angle, 0.0, 0.0], (n, 1)))


def _carried(of: Plan, error: dict[str, np.ndarray], place: np.ndarray) -> np.ndarray:
    """Return (n, 3) the targets in the base, mm, innermost factor first."""
    tool = place.copy()
    n = len(tool)
    zero = np.zeros(n)
    for axis, shift in (
        ("Z", np.stack([zero, zero, of.at("Z")], axis=1)),
        ("Y", np.stack([zero, of.at("Y"), zero], axis=1)),
        ("X", np.stack([of.at("X"), zero, zero], axis=1)),
    ):
        tool = shift + error[axis][:, :3] + np.einsum("nij,nj->ni", _exp(error[axis][:, 3:]), tool)
    tool = tool + np.array([-250.0, -225.0, 400.0])
    work = np.einsum("nij,nj->ni", _rz(-np.radians(of.at("C"))), place)
    for name in ("C", "L_C"):
        work = error[name][:, :3] + np.einsum("nij,nj->ni", _exp(error[name][:, 3:]), work)
    work = work + np.array([0.0, 0.0, -D])
    work = np.einsum("nij,nj->ni", _rz(np.radians(of.at("B"))) @ _rx(n, -np.pi / 4), work)
    for name in ("B", "L_B"):
        work = error[name][:, :3] + np.einsum("nij,nj->ni", _exp(error[name][:, 3:]), work)
    work = np.einsum("nij,nj->ni", _rx(n, np.pi / 4), work) + np.array([0.0, 0.0, D])
    return np.where((of.carrier == "tool")[:, None], tool, work)


def _load(of: Plan, axis: str) -> np.ndarray:
    """Return the torque of gravity, N·m, about B along its command: that of everything on the cradle, about its own axis."""
    if axis == "Z":
        return np.zeros(len(of.q))
    if axis != "B":
        raise ValueError(
            "only B turns a weight on this machine: C stands on its own axis, X and Y are level, Z's load is constant"
        )
    n = len(of.q)
    tilt, spin = _rx(n, np.pi / 4), _rz(np.radians(of.at("B")))
    total = np.zeros(n)
    down = np.array([0.0, 0.0, -G])
    for link, (mass, centre) in MASSES.items():
        local = np.array(centre)
        if link == "table":
            local = _rx(1, -np.pi / 4)[0] @ (local + np.array([0.0, 0.0, -D * 1e-3]))
        arm = np.einsum("nij,j->ni", tilt @ spin, local)
        total += mass * np.cross(arm, down) @ (_rx(1, np.pi / 4)[0] @ [0.0, 0.0, 1.0])
    return total


def _carried_load(of: Plan, axis: str, centre: Mapping[str, float]) -> np.ndarray:
    """Return the torque, N·m, about B by the load of each row at ``load_x``, ``load_y``, ``load_z`` mm of the work frame.

    For Z, the force, N, by the load in the spindle.
    """
    if axis == "Z":
        return -G * of.load_kg
    place = np.tile([centre.get("load_x", 0.0), centre.get("load_y", 0.0), centre["load_z"]], (len(of.q), 1))
    step, total = 1e-3, []
    for way in (1.0, -1.0):
        q = of.q.copy()
        q[:, AXES.index("B")] += way * np.degrees(step)
        none = {name: np.zeros((len(q), 6)) for name in ("X", "Y", "Z", "B", "C", "L_B", "L_C")}
        work = replace(of, q=q, target=np.array(["T"] * len(q)))
        total.append(1e-3 * G * of.load_kg * _carried(work, none, place)[:, 2])
    return -(total[0] - total[1]) / (2.0 * step)


def _quarter(of: Plan, centre: Mapping[str, float]) -> np.ndarray:
    """Return the ratio of the load's torque to that of the cradle with B at 90° and C at zero."""
    at = replace(of, q=np.tile([0.0, 0.0, 0.0, 90.0, 0.0], (len(of.q), 1)))
    return _carried_load(at, "B", centre) / _load(at, "B")
