"""Executes programs in the manner of postprocessors on the DMU 50 without errors; shares no code with `twin`.

A small subset of each language, read word by word: what the programs in `corpus` use. Positions are those of the axes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from tests.truth.reference import D, about, translation

OFFSETS = {
    **{"G54": (250.0, 225.0, -390.0), "G55": (200.0, 180.0, -380.0), "G505": (240.0, 215.0, -385.0)},
    **{"G15 H1": (250.0, 225.0, -390.0), "1": (250.0, 225.0, -390.0), "2": (230.0, 240.0, -395.0)},
}
LENGTHS = {"1": 80.0, "2": 131.5, "12": 65.25, "MILL_D10": 92.5}
ROTARY_INCREMENT = 0.001
_WORD = re.compile(r"([A-Z]+\d(?=\s*=)|[A-Z]+)\s*=?\s*([-+]?(?:\d+\.?\d*|\.\d+))")
_CYCLES = {"73", "81", "82", "83", "84", "84.2", "85", "87"}
_UNITS = {"20", "21", "70", "700", "710"}


def table_of(b_deg: float, c_deg: float) -> np.ndarray:
    """Return the (4, 4) pose of the workpiece in the machine."""
    b, c = np.radians([b_deg, c_deg])
    swivel = about(0, np.pi / 4) @ about(2, b) @ about(0, -np.pi / 4)
    return translation(0, 0, D) @ swivel @ translation(0, 0, -D) @ about(2, -c)


def standing(
    normal: np.ndarray, near: tuple[float, float], increment: float | None = ROTARY_INCREMENT
) -> tuple[float, float]:
    """Return the rotary axes for a tool along a normal in the workpiece: the solution nearer to others, at their increment if any."""
    low, high = 0.0, 180.0
    for _ in range(60):
        b = 0.5 * (low + high)
        low, high = (b, high) if table_of(b, 0.0)[2, 2] > normal[2] else (low, b)
    if b < 1e-4:
        return 0.0, near[1]
    axis = np.linalg.inv(table_of(b, 0.0)[:3, :3])[:, 2]
    c = np.degrees(np.arctan2(axis[1], axis[0]) - np.arctan2(normal[1], normal[0]))
    turned = [np.linalg.inv(table_of(b, sign * c)[:3, :3])[:, 2] for sign in (1.0, -1.0)]
    c = c if np.linalg.norm(turned[0] - normal) < 1e-9 else -c
    c += 360.0 * round((near[1] - c) / 360.0)
    return (b, c) if increment is None else tuple(np.round(np.array([b, c]) / increment) * increment)


class Run:
    """One execution: its state, and in ``ends`` the axis positions at block ends, whether it is a feed, and the tool length."""

    def __init__(self) -> None:
        self.words = dict.fromkeys("XYZBC", np.nan)
        self.ends: list[tuple[np.ndarray, bool, float]] = []
        self.offset, self.tool, self.length = "G54", "", 0.0
        self.offsets = dict(OFFSETS)
        self.shift, self.turn = np.zeros(3), np.eye(3)
        self.tcp = self.rapid = False
        self.plane: tuple[np.ndarray, np.ndarray] | None = None
        self.pending: tuple[np.ndarray, np.ndarray] | None = None
        self.given: list[dict[str, float]] = []
        self.pole, self.radius = [0.0, 0.0], np.nan

    def at(self) -> np.ndarray:
        """Return the axis positions."""
        xyz = np.array([self.words[axis] for axis in "XYZ"])
        rotary = np.nan_to_num([self.words[axis] for axis in "BC"])
        zero = np.array(self.offsets[self.offset])
        if self.plane is None and not self.tcp:
            return np.array([*(self.turn @ xyz + self.shift + zero + [0, 0, self.length]), *rotary])
        turn, origin = (self.turn, self.shift) if self.plane is None else self.plane
        within = 0.0 if self.plane is None else self.shift
        tip = turn @ (xyz + within) + origin + zero + [-250.0, -225.0, 400.0]
        x, y, z, _ = table_of(*rotary) @ [*tip, 1.0]
        return np.array([x + 250.0, y + 225.0, z - 400.0 + self.length, *rotary])

    def go(self, rapid: bool) -> None:
        """Record the end of a block."""
        at = self.at()
        if np.isfinite(at).all():
            self.ends.append((at, not rapid, LENGTHS.get(self.tool, self.length)))

    def set_pole(self, code: str, values: dict[str, float]) -> None:
        """Set the pole of SINUMERIK from its last position, zero or the pole before."""
        from_ = {"110": [self.words["X"], self.words["Y"]], "111": [0.0, 0.0], "112": self.pole}[code]
        self.pole = [from_[0] + values.get("X", 0.0), from_[1] + values.get("Y", 0.0)]

    def end_of_path(self, values: dict[str, float], code: str) -> dict[str, float]:
        """Return the end point of a block of SINUMERIK given about the pole, by a direction, or by an opening angle."""
        x, y = self.words["X"], self.words["Y"]
        if "AP" in values or "RP" in values:
            self.radius = values.get("RP", self.radius)
            end = self.pole[0] + self.radius * np.exp(1j * np.radians(values["AP"])) + 1j * self.pole[1]
            return {"X": end.real, "Y": end.imag}
        if "ANG" in values:
            return {"Y": y + (values["X"] - x) * np.tan(np.radians(values["ANG"]))}
        if "AR" in values and "I" in values:
            centre = complex(x + values["I"], y + values.get("J", 0.0))
            turn = np.radians(values["AR"]) * (-1 if code == "2" else 1)
            end = centre + (complex(x, y) - centre) * np.exp(1j * turn)
            return {"X": end.real, "Y": end.imag}
        return {}

    def polar(self, given: dict[str, float], relative: bool, unit: float) -> dict[str, float]:
        """Return X and Y of polar words, which count from the zero of the coordinates."""
        x, y = self.words["X"], self.words["Y"]
        distance, angle = np.hypot(x, y), np.degrees(np.arctan2(y, x))
        distance = given.get("@", 0.0 if relative else distance / unit) * unit + (distance if relative else 0.0)
        angle = given.get("^", 0.0 if relative else angle) + (angle if relative else 0.0)
        return {"X": distance * np.cos(np.radians(angle)), "Y": distance * np.sin(np.radians(angle))}

    def forget(self, axes: str) -> None:
        """Forget the words of axes: their coordinates are others now."""
        self.words |= dict.fromkeys(axes, np.nan)

    def switched(self) -> str:
        """Return the axes whose words change with tool centre point control: at B0 C0 only that of Z."""
        return "Z" if self.plane is None and self.words["B"] == self.words["C"] == 0.0 else "XYZ"

    def tilt(self, turn: np.ndarray, origin: np.ndarray, *, stands: bool = False) -> None:
        """Enter a plane; ``stands``: the program has positioned the rotary axes."""
        if not stands:
            near = tuple(np.nan_to_num([self.words[axis] for axis in "BC"]))
            self.words["B"], self.words["C"] = standing(turn[:, 2], near)
        self.plane, self.pending = (turn, origin), None
        self.forget("XYZ")

    def swivel(self, parts: list[str]) -> None:
        """Execute CYCLE800 of SINUMERIK: a new plane or one within the present one, by angles about x, y, z or by solid angles."""
        if not any(parts) or parts[1] == '"0"':
            self.plane = None
            self.forget("XYZ")
            return
        values = [float(part) if part and part[0] != '"' else 0.0 for part in parts]
        solid = values[3] == 64
        turn = Rotation.from_euler("ZY" if solid else "XYZ", values[7 : 9 if solid else 10], degrees=True).as_matrix()
        origin = np.array(values[4:7]) + turn @ values[10:13]
        if values[2] % 10 and self.plane:
            turn, origin = self.plane[0] @ turn, self.plane[1] + self.plane[0] @ origin
        self.tilt(turn, origin)

    def through(self, step: int, words: dict[str, float]) -> None:
        """Take a block of a plane by points or vectors, and define the plane from the last one."""
        self.given = [*(self.given if step > 1 else []), words]
        first, last = self.given[0], self.given[-1]
        origin = np.array([first[axis] for axis in "XYZ"])
        if "I" in last:
            x, z = (np.array([one[axis] for axis in "IJK"]) for one in (first, last))
        elif step == 3:
            x, side = (np.array([one[axis] for axis in "XYZ"]) - origin for one in self.given[1:])
            z = np.cross(x, side)
        if step == (2 if "I" in last else 3):
            x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
            self.pending = np.stack([x, np.cross(z, x), z], axis=1), origin

    def program_frame(self, added: bool, kind: str, values: dict[str, float]) -> None:
        """Shift or turn the coordinates as SINUMERIK does."""
        if not added:
            self.shift, self.turn = np.zeros(3), np.eye(3)
        if kind == "TRANS":
            self.shift = self.shift + self.turn @ [values.get(axis, 0.0) for axis in "XYZ"]
        for axis, angle in values.items() if kind == "ROT" else ():
            self.turn = self.turn @ Rotation.from_euler(axis, angle, degrees=True).as_matrix()
        self.forget("XYZ")


def run_iso(text: str) -> Run:
    """Execute a program of Fanuc, Haas, Okuma or SINUMERIK."""
    run, okuma, chosen = Run(), "G15 H" in text, ""
    text = re.sub(r"\A=+\n.*?\n=+\n", "", text, flags=re.DOTALL)  # what a CAM system lists above
    cycle: dict[str, float] = {}
    code, relative, initial, to_initial, unit = "0", False, np.nan, True, 1.0
    for line in _with_subprograms(re.sub(r"\(\*.*", "", text)):
        bare = re.sub(r"CYCLE800\((.*)\)", lambda m: f"@{m[1]}@", line.upper())
        called = re.search(r"MCALL\s+CYCLE(8[123])\(([^()]*)\)", bare)
        bare = re.sub(r"\([^()]*\)|;.*|^N\d+", "", bare).strip()
        once = re.match(r"(?:N\d+\s+)?CYCLE83\(([^,]*),", line)
        if once:
            run.words["Z"] = float(once[1])  # the cycle itself is left to the control
            continue
        if called or bare == "MCALL":
            level, plane, distance, depth = (
                (float(part) * unit for part in called[2].split(",")[:4]) if called else (0,) * 4
            )
            cycle = {"on": 1.0, "R": plane + distance, "Z": depth, "level": level} if called else {}
            code_of_cycle = called[1] if called else ""
            continue
        if "@" in bare and "CYCLE800" in line.upper():
            run.swivel([part.strip() for part in bare.split("@")[1].split(",")])
            continue
        if re.search(r"G65\b|M98\b", bare):
            continue  # a macro of the machine's builder, which is not given
        if "M70" in bare:
            saved = relative, unit
        if "M72" in bare:
            relative, unit = saved
        bare = re.sub(r"-\[(\d+)\+#<DEPTH>\]", lambda m: f"-{int(m[1]) + 4}", bare.replace("#1500", "12.5"))
        framed = re.match(r"(A?)(TRANS|ROT)\b(.*)", bare)
        if framed:
            run.program_frame(
                framed[1] == "A",
                framed[2],
                {axis.replace("RPL", "Z"): float(value) for axis, value in _WORD.findall(framed[3])},
            )
            continue
        words = [(name, value) for name, value in _WORD.findall(re.sub(r'"[^"]*"', "1", bare)) if name != "N"]
        name = re.search(r'T="([^"]*)"', line)
        codes = [value.lstrip("0") or "0" for word, value in words if word == "G"]
        unit = {"20": 25.4, "70": 25.4, "700": 25.4, "21": 1.0, "710": 1.0}.get(next(iter({*codes} & _UNITS), ""), unit)
        scaled = {*"XYZRIJK"} - ({*"IJK"} if {"68.2", "268"} & {*codes} else set())
        values = {
            word: float(value) * (unit if word in scaled else 1.0) for word, value in words if word not in ("G", "M")
        }
        tools = [f"{float(value):g}" for word, value in words if word == "T"]
        chosen = name[1] if name else tools[0] if tools else chosen
        run.tool = chosen if re.search(r"M0?6\b", bare) else run.tool
        chosen = tools[-1] if len(tools) > 1 else chosen  # Mazak: the second one is the next tool
        machine = "SUPA" in bare or ("53" in codes and not okuma)
        for one in codes:
            key = f"G15 H{values['H']:g}" if one == "15" else f"G{one}"
            if key in OFFSETS:
                run.offset = key
                run.forget("XYZBC")
            if one in ("43", "43.4", "234", "169") or (okuma and one == "56"):
                run.length = LENGTHS[f"{values.get('H', values.get('HA', float(run.tool or 0))):g}"]
                run.tcp = one in ("43.4", "234", "169")
                run.forget(run.switched() if run.tcp else "Z")
            if one == "43.1":
                run.length = values.pop("Z")
                run.forget("Z")
            if one in ("49", "170") or (okuma and one == "53"):
                run.forget(run.switched() if run.tcp else "Z")
                run.tcp, run.length = False, 0.0
            if one == "268":
                turn = Rotation.from_euler("xyz", [values[k] for k in "IJK"], degrees=True).as_matrix()
                run.pending = turn, np.array([values[axis] for axis in "XYZ"])
            if one == "68.2" and values.get("P"):
                if values["Q"]:
                    run.through(int(values["Q"]), values)
            elif one == "68.2":
                turn = Rotation.from_euler("ZXZ", [values.get(k, 0.0) for k in "IJK"], degrees=True).as_matrix()
                run.pending = turn, np.array([values.get(axis, 0.0) for axis in "XYZ"])
            if one in ("53.1", "53.3", "53.6", "253") and run.pending:
                run.tilt(*run.pending)
            if one == "254":
                run.tilt(np.linalg.inv(table_of(run.words["B"], run.words["C"])[:3, :3]), np.zeros(3), stands=True)
            if one in ("69", "255", "269"):
                run.plane = None
                run.forget("XYZ")
            relative = {"90": False, "91": True}.get(one, relative)
            to_initial = {"98": True, "99": False}.get(one, to_initial)
            if one in ("0", "1", "2", "3", "53.3"):
                code, cycle = one.replace("53.3", "0"), {}
            if one == "80":
                cycle = {}
            if one in _CYCLES:
                initial, code_of_cycle = run.words["Z"], one
                cycle = {"on": 1.0}
        if "TRAORI" in bare or "TRAFOOF" in bare:
            run.tcp = "TRAORI" in bare
            run.forget("XYZ")
        if re.search(r"\bD1\b", bare) and run.tool:
            run.length = LENGTHS[run.tool]
            run.forget("Z" if not run.tcp else "")
        if codes in (["110"], ["111"], ["112"]):
            run.set_pole(codes[0], values)
            continue
        axes = {axis: values[axis] for axis in "XYZBC" if axis in values} | run.end_of_path(
            values, code_in(codes, code)
        )
        vector = [values.get(name) for name in ("A3", "B3", "C3")]
        if run.tcp and None not in vector:
            near = tuple(np.nan_to_num([run.words[axis] for axis in "BC"]))
            axes |= dict(zip("BC", standing(np.array(vector) / np.linalg.norm(vector), near, None), strict=True))
        polar = dict(re.findall(r"([@^])\s*([-+]?[\d.]+)", bare))
        axes |= run.polar({name: float(value) for name, value in polar.items()}, relative, unit) if polar else {}
        if "33.1" in codes:
            continue  # the thread itself is left to the control
        if "10" in codes:
            name = f"G{53 + int(values['P'])}"
            run.offsets[name] = tuple(values.get(a, old) for a, old in zip("XYZ", run.offsets[name], strict=True))
            run.forget("XYZ" if name == run.offset else "")
            continue
        if "52" in codes:
            run.shift = np.array([values.get(axis, place) for axis, place in zip("XYZ", run.shift, strict=True)])
            run.forget("XYZ")
            continue
        if {"68.2", "268", "28", "4"} & {*codes} or not axes:
            if "28" in codes:
                run.forget("".join(axes))
            continue
        if machine:
            run.forget("".join(axes))
            continue
        if run.pending and not {*axes} & {*"BC"}:
            run.plane, run.pending = run.pending, None  # the program has positioned the rotary axes
            run.forget("XYZ")
        if cycle:
            heights = {axis: values[axis] for axis in "ZR" if axis in values}
            if relative and heights:
                heights["R"] += initial
                heights["Z"] += heights["R"]
            cycle |= heights
            axes = axes if called_by_name(cycle) else {axis: value for axis, value in axes.items() if axis != "Z"}
        for hole in range(int(values.get("L", 1)) if cycle else 1):
            axes |= run.polar({name: float(value) for name, value in polar.items()}, relative, unit) if hole else {}
            for axis, value in axes.items():
                run.words[axis] = value + (run.words[axis] if relative and not polar else 0.0)
            run.go(code == "0" or bool(cycle))
            if not cycle:
                continue
            # The bottom of a thread is left to the control, uncorrected.
            back = cycle.get("level", initial if to_initial else cycle["R"])
            strokes = [(cycle["R"], True), (cycle["Z"], False), (back, True)]
            if code_of_cycle in ("84", "84.2", "73"):
                strokes = strokes[::2]
            if code_of_cycle == "87":
                strokes, back = [], initial  # from the initial level and back
            if called_by_name(cycle) and code_of_cycle == "83":
                strokes = strokes[:1]
            for height, rapid in strokes:
                run.words["Z"] = height
                run.go(rapid)
            run.words["Z"] = back
    return run


def code_in(codes: list[str], before: str) -> str:
    """Return the motion code in force."""
    return next((one for one in codes if one in "0123"), before)


def called_by_name(cycle: dict[str, float]) -> bool:
    """Return whether a cycle is one of SINUMERIK, in whose blocks Z is a position."""
    return "level" in cycle


def _with_subprograms(text: str) -> Iterator[str]:
    """Yield the lines of a program up to its end, with those of the subprograms that ``M98 P.. L..`` calls."""
    lines = text.splitlines()
    for line in lines:
        call = re.search(r"^[^(]*\bM98\s*P0*(\d+)(?:\s*L(\d+))?", line)
        if call and not call[1].startswith("9"):
            begin = next(i for i, one in enumerate(lines) if re.match(rf"O0*{call[1]}\b", one))
            end = next(i for i, one in enumerate(lines) if i > begin and re.search(r"\bM99\b", one))
            yield from lines[begin + 1 : end] * int(call[2] or 1)
            continue
        yield line
        if re.search(r"\bM0?(?:2|30)\b", line):
            return


def _written_out(text: str) -> Iterator[str]:
    """Yield the blocks of a program in plain language without numbers and comments, its subprograms written out."""
    points = re.sub(r"(\d),(\d)", r"\1.\2", text)
    blocks = [re.sub(r"^/?N?\d+\s+|;.*|~\s*$", "", line.strip()).strip() for line in points.splitlines()]
    blocks = [re.sub(r"^CYCLE ", "CYCL ", block) for block in blocks]
    ends = [i for i, block in enumerate(blocks) if re.search(r"\bM30\b|END PGM", block)]
    for block in blocks[: ends[0] + 1]:
        called = re.match(r'CALL LBL (\d+|"\w+")$', block)
        if called:
            begin = blocks.index(f"LBL {called[1]}")
            yield from blocks[begin + 1 : blocks.index("LBL 0", begin)]
        else:
            yield block


def _rotation(block: str) -> np.ndarray:
    """Return the axes of a plane as columns."""
    numbers = [float(value) for value in re.findall(r"(?:SP[ABC]|[BN][XYZ])\s*([-+]?[\d.]+)", block)]
    if block.startswith("PLANE SPATIAL"):
        return Rotation.from_euler("xyz", numbers, degrees=True).as_matrix()
    x, z = np.array(numbers[:3]), np.array(numbers[3:]) / np.linalg.norm(numbers[3:])
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _pattern(text: str) -> list[tuple[float, float, float]]:
    """Return the places of ``PATTERN DEF`` and the shift of the surface at each."""
    places = []
    for kind, body in re.findall(r"(POS|ROW|CIRC)\d \(([^)]*)\)", text):
        at = {name: float(value) for name, value in re.findall(r"([A-Z]+)([-+\d.]+)", body)}
        first = complex(at["X"], at["Y"])
        steps = [0j]
        if kind == "ROW":
            steps = [i * at["D"] * np.exp(1j * np.radians(at["ROT"])) for i in range(int(at["NUM"]))]
        if kind == "CIRC":
            angles = [np.radians(at["START"] + 360.0 * i / at["NUM"]) for i in range(int(at["NUM"]))]
            steps = [at["D"] / 2 * np.exp(1j * angle) for angle in angles]
        places += [((first + step).real, (first + step).imag, at["Z"]) for step in steps]
    return places


def _pattern_of_cycle(number: str, q: dict[str, float]) -> list[tuple[float, float, float]]:
    """Return the places of cycles 220 (a whole circle) and 221."""
    if number == "220":
        turns = [np.radians(q["Q245"] + 360.0 * i / q["Q241"]) for i in range(int(q["Q241"]))]
        holes = [complex(q["Q216"], q["Q217"]) + q["Q244"] / 2 * np.exp(1j * turn) for turn in turns]
    else:
        along, across = (q[name] * np.exp(1j * np.radians(q["Q224"])) for name in ("Q237", "Q238"))
        rows = [[i * along + 1j * row * across for i in range(int(q["Q242"]))] for row in range(int(q["Q243"]))]
        holes = [
            complex(q["Q225"], q["Q226"]) + one for i, row in enumerate(rows) for one in (row[::-1] if i % 2 else row)
        ]
    return [(hole.real, hole.imag, 0.0) for hole in holes]


def _drill_at(run: Run, places: list[tuple[float, float, float]], q: dict[str, float]) -> None:
    """Drill at places, between them at the height before or at the second clearance, whichever is higher."""
    before = run.words["Z"]
    for x, y, shift in places:
        surface = q["Q203"] + shift
        level = surface + max(q["Q200"], q["Q204"])
        if len(places) > 1 and run.words["Z"] < max(before, level) - 1e-9:
            run.words["Z"] = max(before, level)
            run.go(True)
        run.words |= {"X": x, "Y": y}
        run.go(True)
        run.words["Z"] = surface + q["Q200"]
        run.go(True)
        run.words["Z"] = level


def run_plain(text: str) -> Run:
    """Execute a program in plain language."""
    run, called, parameters, below = Run(), False, dict[str, float](), np.zeros(3)
    points, waiting = "", ""
    unit = 25.4 if re.search(r"BEGIN PGM .*IN(CH)?\s*$", text, re.MULTILINE) else 1.0
    for block in filter(None, _written_out(text)):
        if waiting and not block.startswith("Q"):
            _drill_at(run, _pattern_of_cycle(waiting, parameters), parameters)
            waiting = ""
        if re.match(r"PATTERN|(POS|ROW|CIRC)\d", block):
            points = block if block.startswith("PATTERN") else f"{points} {block}"
        if re.match(r"CYCL DEF 22[01]", block):
            waiting = block.split()[2]
        if block.startswith(("CYCL CALL PAT", "CYCL CALL POS")):
            at = [float(value) for value in re.findall(r"[XYZ]([-+][\d.]+)", block)]
            _drill_at(run, [(at[0], at[1], at[2])] if at else _pattern(points), parameters)
            continue
        parameters |= {name: float(value) for name, value in re.findall(r"(Q\d+)\s*=\s*([-+]?[\d.]+)", block)}
        if block.startswith("CYCL DEF 247") or "Q339" in block:
            if "Q339" in block:
                run.offset = f"{parameters['Q339']:g}"
                run.forget("XYZBC")
        elif block.startswith("TRANS DATUM"):
            run.shift = np.array([float(value) for value in re.findall(r"[XYZ]([-+]?[\d.]+)", block)] or [0.0] * 3)
            run.forget("XYZ")
        elif re.match(r"CYCL DEF 7\.[123]", block):
            axis, value = re.findall(r"([XYZ])([-+]?[\d.]+)", block.split(maxsplit=3)[-1])[0]
            run.shift["XYZ".index(axis)] = float(value)
            run.forget("XYZ")
        elif block.startswith("TOOL CALL"):
            run.tool = re.findall(r'TOOL CALL "?(\w+)"?', block)[0]
            run.length = LENGTHS[run.tool]
            run.forget("Z")
        elif block.startswith("PLANE RESET"):
            run.plane, run.shift = None, below
            run.forget("XYZ" if "STAY" in block else "XYZBC")
        elif block.startswith("CYCL DEF 19.1"):
            angles = dict(re.findall(r"([ABC])([-+]?[\d.]+)", block))
            turn = Rotation.from_euler("xyz", [float(angles.get(axis, 0)) for axis in "ABC"], degrees=True).as_matrix()
            run.pending = (turn, run.shift) if angles else None
            if not angles and run.plane is not None:
                run.plane, run.shift = None, below
                run.forget("XYZBC")
            elif angles:
                below, run.shift = run.shift, np.zeros(3)
        elif block.startswith("PLANE"):
            plane = _rotation(block), run.shift
            below, run.shift = run.shift, np.zeros(3)
            if "STAY" in block:
                run.pending = plane
            else:
                run.tilt(*plane)
        elif "Q121" in block and run.pending:
            run.tilt(*run.pending)
        elif "M128" in block or "M129" in block or "TCPM" in block:
            run.tcp = "M128" in block or block.startswith("FUNCTION TCPM")
            run.forget("XYZ")
        elif block.startswith("CC"):
            centre = {axis: float(value) for axis, value in re.findall(r"([XY])([-+]?[\d.]+)", block)}
        elif re.match(r"(?:LP|APPR P|DEP P)", block):
            at = {name: float(value) for name, value in re.findall(r"(P[RA])([-+][\d.]+)", block)}
            here = complex(run.words["X"] - centre["X"], run.words["Y"] - centre["Y"])
            end = at.get("PR", abs(here)) * np.exp(1j * np.radians(at["PA"]))
            run.words |= {"X": centre["X"] + end.real, "Y": centre["Y"] + end.imag}
            run.go("FMAX" in block)
        elif block.startswith("CP"):
            turn, up = np.radians(float(re.findall(r"IPA([-+][\d.]+)", block)[0])), re.findall(r"IZ([-+][\d.]+)", block)
            x, y = (run.words[axis] - centre[axis] for axis in "XY")
            run.words["X"] = centre["X"] + x * np.cos(turn) - y * np.sin(turn)
            run.words["Y"] = centre["Y"] + x * np.sin(turn) + y * np.cos(turn)
            run.words["Z"] += float(up[0]) if up else 0.0
            run.go(False)
        elif block.startswith("LN"):
            words = {name: float(value) for name, value in re.findall(r"([NT]?[XYZ])([-+]?[\d.]+)", block)}
            tool = np.array([words[f"T{axis}"] for axis in "XYZ"])
            near = tuple(np.nan_to_num([run.words[axis] for axis in "BC"]))
            turned = dict(zip("BC", standing(tool / np.linalg.norm(tool), near, None), strict=True))
            run.words |= {axis: value * unit for axis, value in words.items() if axis in run.words} | turned
            run.go(False)
        elif re.match(r"(?:L|C|CR|CT|APPR|DEP|CYCL CALL)\b", block):
            words = re.sub(r"\b(?:R\+?\d[\d.]*|LEN\+?[\d.]+|CCA\+?[\d.]+|S\d+|F\d[\d.]*|M\d+)", "", block)
            axes = {
                axis: float(value) for axis, value in re.findall(r"(?<![A-Z])([XYZBC])([-+]?(?:\d[\d.]*|\.\d+))", words)
            }
            if "M91" in block or "M140" in block or (block.startswith("DEP") and not axes):
                run.forget("".join(axes) or ("XY" if block.startswith("DEP") else "XYZ"))
                continue
            run.words |= {axis: value * (unit if axis in "XYZ" else 1.0) for axis, value in axes.items()}
            if axes:
                run.go("FMAX" in block)
            called = "M99" in block or block.startswith("CYCL CALL")
            if called:
                surface, clearance = parameters["Q203"], parameters["Q200"]
                run.words["Z"] = surface + clearance
                run.go(True)
                # twin leaves the way from there to the bottom and back to the control, uncorrected.
                run.words["Z"] = surface + max(clearance, parameters["Q204"])
    return run
