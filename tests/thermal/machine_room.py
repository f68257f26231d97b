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


def write(columns: dict[str, np.ndarray], path: Path, start: int = 0, stop: int | None = None) -> Path:
    """Write columns, or some of their rows, as a CSV record."""
    table = np.stack(list(columns.values()), axis=1)[start:stop]
    rows = [",".join(f"{value:.4f}" for value in row) for row in table]
    path.write_text("\n".join([",".join(columns), *rows, ""]))
    return path
