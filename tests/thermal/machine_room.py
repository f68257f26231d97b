"""A simulated machine in a room: a lumped thermal network stepped in seconds. Shares no code with `twin`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

MINUTE = 60


def simulate(
    seed: int,
    hours: float = 12.0,
    speeds: tuple[float, ...] = (0, 1500, 0, 3000, 0, 2000),
    bed_um_per_K: float = 6.0,
    growth_um: float = 12.0,
    drift_um: float = 0.0,
    copies: int = 0,
    unrelated: bool = False,
    noise_um: float = 0.15,
) -> dict[str, np.ndarray]:
    """Return columns of a record, a row every two minutes.

    The displacement is that of a bed that follows its sensor with 40 minutes, of a spindle bearing heated by the square of the speed
    (20 minutes, ``growth_um`` at 3000 rpm), of a decaying drift (3 hours), and of correlated noise.
    """
    generator = np.random.default_rng(seed)
    count = int(hours * 3600)
    phase, period = generator.uniform(0, 6.28), generator.uniform(3.0, 5.0) * 3600
    room, hall, bed, bearing, wander = 21.0, 0.0, 0.0, 0.0, 0.0
    rows = []
    slot = count / len(speeds)
    for second in range(0, count, 10):
        speed = speeds[min(int(second / slot), len(speeds) - 1)]
        hall += 10.0 / 1800.0 * (-hall) + generator.normal(0.0, 0.06)
        room = 21.0 + 1.5 * np.sin(second / period * 6.28 + phase) + hall
        if second == 0:
            bed = start = room
        bed += 10.0 / 2400.0 * (room - bed)
        bearing += 10.0 / 1200.0 * ((speed / 3000.0) ** 2 - bearing)
        wander += 10.0 / 1800.0 * (-wander) + generator.normal(0.0, 0.02)
        if second % (2 * MINUTE) == 0:
            drift = drift_um * (1.0 - np.exp(-second / 10800.0))
            reading = bed_um_per_K * (bed - start) + growth_um * bearing + drift + wander
            rows.append((second, speed, room, reading))
    time_s, speed, temperature, reading = np.array(rows).T
    size = len(time_s)
    found = {
        "time_s": time_s,
        "spindle_rpm": speed,
        "T_room_degC": temperature + generator.normal(0.0, 0.02, size),
        "Z_um": reading + generator.normal(0.0, noise_um, size),
    }
    for k in range(copies):
        found[f"T_copy{k}_degC"] = temperature + 0.7 + generator.normal(0.0, 0.05, size)
    if unrelated:
        walk = np.cumsum(generator.normal(0.0, 0.08, size))
        found["T_office_degC"] = 22.0 + walk
    return found


def structure(
    seed: int, hours: float = 46.0, sensors: int = 8, nodes: int = 8, step: float = 20.0
) -> dict[str, np.ndarray]:
    """Return columns of a record of a spindle in a network of heat capacities, a row every two minutes.

    Capacities, conductances, speeds and room are drawn. Two nodes have no sensor, heat falls as the bearing warms, and the exponent of
    the speed is neither one nor two, so that no sum of the fitted terms is exact.
    """
    rng = np.random.default_rng(seed)
    capacity = np.exp(rng.normal(np.log(3000.0), 0.8, nodes))
    conductance = np.zeros((nodes, nodes))
    for i in range(1, nodes):
        conductance[i, rng.integers(0, i)] = np.exp(rng.normal(0.0, 0.5))
    conductance += conductance.T
    to_room = np.exp(rng.normal(np.log(0.4), 0.5, nodes))
    heat, exponent = rng.uniform(6.0, 14.0) * (np.arange(nodes) == 0), rng.uniform(1.0, 2.0)
    speeds = [0.0 if k % 2 else float(rng.choice([1000, 2000, 3000, 4000, 5000])) for k in range(int(hours // 4) + 1)]
    period, phase, size = rng.uniform(18.0, 26.0) * 3600.0, rng.uniform(0.0, 6.28), rng.uniform(0.5, 2.5)
    temperature, hall, rows = rng.normal(0.0, 0.5, nodes), 0.0, []
    for k in range(int(hours * 3600 / step)):
        speed = speeds[int(k * step / 14400)]
        hall += step / 5400.0 * -hall + rng.normal(0.0, 0.25) * np.sqrt(2.0 * step / 5400.0)
        room = size * np.sin(6.28 * k * step / period + phase) + hall + 0.5 * np.sin(6.28 * k * step / 1900.0)
        flow = conductance @ temperature - conductance.sum(axis=1) * temperature + to_room * (room - temperature)
        flow += heat * (speed / 5000.0) ** exponent * (1.0 - 0.02 * temperature[0])
        temperature = temperature + step * flow / capacity
        if k % round(2 * MINUTE / step) == 0:
            rows.append([k * step, speed, room, *temperature])
    time_s, speed, room, *warm = np.array(rows).T
    found = {"time_s": time_s, "spindle_rpm": speed, "T_room_degC": 22.0 + room}
    seen = rng.permutation(nodes)[2:]
    for k in range(1, sensors):
        one, other = rng.choice(seen, 2)
        share = rng.uniform(0.6, 1.0)
        found[f"T_{k}_degC"] = 22.0 + share * warm[one] + (1.0 - share) * warm[other] + rng.normal(0.0, 0.03, len(room))
    for name in ("Y_um", "Z_um"):
        by_node = rng.normal(0.0, 4.0, nodes) * (rng.random(nodes) < 0.5)
        found[name] = by_node @ (np.array(warm) - np.array(warm)[:, :1]) + rng.normal(0.0, 0.1, len(room))
    return found


def warm_up() -> dict[str, np.ndarray]:
    """Return the columns of the records that come with `twin`: 30 hours, a row every four minutes."""
    columns = structure(111, hours=30.0, sensors=4)
    for number, name in enumerate(("head", "column", "bed"), 1):
        columns[f"T_{name}_degC"] = columns.pop(f"T_{number}_degC")
    return {name: values[::2] for name, values in columns.items()}


def write(columns: dict[str, np.ndarray], path: Path, start: int = 0, stop: int | None = None) -> Path:
    """Write columns, or some of their rows, as a CSV record."""
    table = np.stack(list(columns.values()), axis=1)[start:stop]
    rows = [",".join(f"{value:.4f}" for value in row) for row in table]
    path.write_text("\n".join([",".join(columns), *rows, ""]))
    return path
