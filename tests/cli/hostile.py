"""Invalid inputs for every kind of file that `twin` reads, and functions that read them.

`sample` returns a valid text of each kind; `edited` modifies it; `KINDS` holds the functions that read a file and use the result.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

import twin
from tests.controls.cases import CASES
from tests.measurement.formats.cases import CASES as MEASURED
from tests.measurement.importing import shop_files
from twin._common.bundled import bundled_folder
from twin._common.files import scratch_folder
from twin.compensation.fewer_blocks.emit import points_program
from twin.controls import ControlCurve, ControlTerm, TableSum, format_named, read_tables
from twin.controls.correction import AxisErrors, CorrectionGrid, VolumetricCorrection
from twin.controls.kinematics import kinematics_formats, kinematics_named
from twin.controls.kinematics.format import linear_shift
from twin.identification.axis_layout import AxisLayout, load_readings, simulate_run
from twin.identification.axis_run import axis_curves, error_motions, to_dict, to_text
from twin.measurement.formats import convert
from twin.measurement.formats.tracker import load_export
from twin.measurement.importing import ImportedTable
from twin.measurement.table import Measurements
from twin.nc import DIALECTS, dialect_of
from twin.nc.blocks import AxisWords
from twin.planning import Kit
from twin.reporting.identified import Identified

LONG = 131_100
"""Characters of a cell beyond the default limit of `csv`."""
NUMBERS = [
    *("", "-", "nan", "-inf", "1e308", "-1e308", "1e-308", "1e400", "1e16", "-0", "0", "1e6", "0x10", "1_000", "1,5"),
    *("9" * 400, "9" * 5000, "1." + "0" * 500, "٣", "1e", "+-1", "1:59:59", "-1", "360", "1e9", "1e-9"),
]
TEXTS = [
    *(
        "\x00",
        "\x1b[2J",
        "\x07",
        "\x85",
        "\u2028",
        "\u202e",
        "\ufeff",
        "é",
        "µ",
        "\n",
        "\r",
        "\r\n",
        "\t",
        " " * 80,
        "#",
    ),
    *(
        "'",
        '"',
        '"a',
        '"a\nb"',
        ",",
        ",,",
        ";",
        ",".join("abcdefgh" * 50),
        "x" * LONG,
        "tool",
        "work",
        "base",
        "K",
        "X",
    ),
]
YAML = [
    *(
        "[]",
        "{}",
        "[1, 2]",
        "{a: 1}",
        "*a",
        "&a ",
        "&a [*a]",
        "!foo bar",
        "!!int foo",
        "!!bool x",
        "!!float",
        "!!int ''",
    ),
    *(
        "2001-13-45",
        "2001-12-14",
        "!!timestamp x",
        "!!binary x",
        "!!set {a}",
        "~",
        "true",
        "? [a]\n: b",
        "? ",
        ": ",
        "- ",
    ),
    *("|", ">", "---\n", "...\n", "%YAML 1.1\n", "<<: {a: 1}", "=", "[" * 40, "{a: " * 40, "- " * 40, ".inf", ".nan"),
    *('"\\e[2J"', '"\\0"', '"\\ud800"', "[" * 5000, "!!python/name:os.system ''", "@", "`", "1: 2", "~: 3", "yes: no"),
]
XML = [
    *(
        "<",
        ">",
        "&",
        "&amp;",
        "&#0;",
        "&x;",
        "<!DOCTYPE a [<!ENTITY b 'c'>]>",
        "<a>",
        "</a>",
        "<!--",
        "]]>",
        "<joint/>",
    ),
    *('xyz="0 0 0"', 'xyz="1e308 0 0"', 'xyz="0 0"', 'rpy="nan 0 0"', 'type="fixed"', 'type="floating"', "<mimic/>"),
]
JSON = ["{", "}", "[", "]", "null", "true", "NaN", "Infinity", '"\\ud800"', '"\\u0000"', "1e999", "[" * 200, '"a"', ":"]
NC = [
    "X",
    "G",
    "(",
    ")",
    ";",
    "G91",
    "G2 ",
    "I",
    "R",
    "M30",
    "G53 ",
    "%",
    "=",
    "N",
    "CC",
    "LN",
    "GOTO/",
    "M128",
    "TRAORI",
]


@dataclass(frozen=True)
class Kind:
    """One kind of file.

    Attributes:
        file: name of the file.
        words: words inserted into a valid text, in addition to numbers and characters.
        use: reads a file and uses the result.
        cost: relative cost of `use`.
    """

    file: str
    words: list[str]
    use: Callable[[Path], object]
    cost: int = 1


@cache
def machine() -> twin.Machine:
    return twin.Machine.load("dmu50")


@cache
def axes() -> AxisWords:
    return AxisWords(("X", "Y", "Z"), ("B", "C"), dict.fromkeys("XYZBC", 1e-3))


@cache
def layout() -> AxisLayout:
    return AxisLayout.load(Path(twin.__file__).parent / "samples" / "nine_beams_x.yaml", machine())


def _calibration(path: Path) -> None:
    read = twin.Calibration.load(path, machine())
    read.to_yaml()
    poses = np.array([[250.0, 225.0, -200.0, 30.0, 45.0]])
    assert read.outside(poses).shape == (1, 5)
    assert np.isfinite(read.covariance.matrix).all()


def _imported(path: Path) -> None:
    _shown(twin.import_table(path, machine()))


def _columns(path: Path) -> None:
    _shown(twin.import_table(path.with_name("shop.csv"), machine(), columns=path))


def _shown(found: ImportedTable) -> None:
    found.to_text()
    found.mapping.to_yaml(found.remarks, found.to_confirm)
    json.dumps(found.to_dict(), allow_nan=False)


def _table(path: Path) -> None:
    data = Measurements.load(path, machine())
    data.to_csv(machine())
    evaluated = twin.evaluate(data, machine(), tolerances={"A": 10.0})
    evaluated.to_text()
    json.dumps(evaluated.to_dict(), allow_nan=False)
    drift = twin.evaluate_drift(path, machine())
    drift.to_text()
    json.dumps(drift.to_dict(), allow_nan=False)


def _plan(path: Path) -> None:
    Measurements.load(path, machine(), plan=True)


def _export(path: Path) -> None:
    load_export(path, machine(), [[x, 225.0, -200.0, 0.0, 0.0] for x in (0.0, 100.0, 200.0)], targets=("K", "P"))


def _readings(path: Path) -> None:
    data = load_readings(path, layout())
    motions = error_motions(layout(), data)
    curves = axis_curves(motions, machine(), source="a test")
    to_text(layout(), data, motions, curves)
    json.dumps(to_dict(layout(), data, motions, curves), allow_nan=False)
    curves.calibration.to_yaml()


def _layout(path: Path) -> None:
    AxisLayout.load(path, machine())


def _machine(path: Path) -> None:
    twin.Machine.load(path)


def _urdf(path: Path) -> None:
    file = path.with_suffix(".yaml")
    file.write_text((bundled_folder() / "dmu50.yaml").read_text().replace("dmu50.urdf", path.name))
    loaded = twin.Machine.load(file)
    assert np.isfinite(
        twin.Kinematics(loaded, twin.Calibration.zero(loaded)).forward([[250, 225, -200, 30, 45]]).point_mm
    ).all()


def _kit(path: Path) -> None:
    Kit.load(path, machine())


def _points(path: Path) -> None:
    points_program(path, axes(), DIALECTS, DIALECTS[0], 1000.0)


def _identified(path: Path) -> None:
    Identified.load(path, twin.Calibration.zero(machine())).to_dict()


def _program(path: Path) -> None:
    dialect = dialect_of(path)
    program = dialect.read(path.read_bytes(), str(path))
    dialect.moves(program, axes(), tcp=False)


def _control(kind: str) -> Callable[[Path], None]:
    def use(path: Path) -> None:
        table = read_tables(kind, sorted(path.parent.iterdir()), machine())
        at = dict(zip(machine().names, (250.0, 225.0, -200.0, 30.0, 45.0), strict=True))
        assert all(np.isfinite(float(np.asarray(table.shift(axis, at)))) for axis in table.axes)

    return use


def _kinematics(kind: str) -> Callable[[Path], None]:
    def use(path: Path) -> None:
        used = _machine_of(kind)
        found = linear_shift(used, kinematics_named(kind).read(path, used), np.full((1, 5), 20.0), 100.0)
        assert np.isfinite(found).all()

    return use


def _machine_of(kind: str) -> twin.Machine:
    return twin.Machine.load(bundled_folder() / "trunnion_ac.yaml") if kind == "linuxcnc-trt" else machine()


def _nominal_kinematics(kind: str) -> Callable[[], str]:
    def text() -> str:
        form, used = kinematics_named(kind), _machine_of(kind)
        return form.write(form.nominal(used), used)

    return text


def _measured(name: str) -> Callable[[Path], None]:
    case = MEASURED[name]

    def use(path: Path) -> None:
        machine = twin.Machine.load(case.MACHINE)
        found = convert(path, machine, case.GIVEN, format_name=name)
        found.measurements.to_csv(machine, comment=found.comment)
        found.to_text()
        json.dumps(found.to_dict(), allow_nan=False)

    return use


KINDS: Mapping[str, Kind] = {
    "calibration": Kind("a.yaml", YAML, _calibration),
    "machine": Kind("a.yaml", YAML, _machine, 3),
    "kit": Kind("a.yaml", YAML, _kit),
    "layout": Kind("a.yaml", YAML, _layout),
    "table": Kind("a.csv", [], _table),
    "plan": Kind("a.csv", [], _plan),
    "import": Kind("a.csv", ["X-Soll", "[mm]", "[in]", "\u00b5m", "0,5", "1.234", "1.234,5", "24.11.2026"], _imported),
    "columns": Kind("a.yaml", YAML, _columns),
    "readings": Kind("a.csv", [], _readings, 4),
    "export": Kind("a.csv", [], _export),
    "points": Kind("a.csv", [], _points),
    "siemens": Kind("a.mpf", NC, _control("siemens")),
    "siemens_eec": Kind("a.mpf", NC, _control("siemens_eec")),
    "heidenhain": Kind("X_CORR.COM", NC, _control("heidenhain")),
    "isg": Kind("a.csv", [], _control("isg")),
    "linuxcnc": Kind("X.comp", [], _control("linuxcnc")),
    "ini": Kind("joints.ini", ["[JOINT_0]", "COMP_FILE = x"], _control("linuxcnc")),
    "grid": Kind("a.csv", [], _control("grid")),
    "identified": Kind("a.json", JSON, _identified),
    "iso": Kind("a.nc", NC, _program),
    "plain language": Kind("a.h", NC, _program),
    "apt": Kind("a.cls", NC, _program),
    "urdf": Kind("a.urdf", XML, _urdf, 4),
    **{form.name: Kind(form.file, [], _kinematics(form.name)) for form in kinematics_formats()},
    **{f"measured by {name}": Kind(case.FILE, [], _measured(name), 2) for name, case in MEASURED.items()},
}


def _csv(head: str, rows: np.ndarray, tail: str = "") -> str:
    return head + "\n" + "".join(",".join(f"{q:g}" for q in row) + f"{tail}\n" for row in rows)


@cache
def sample(kind: str) -> str:
    """Return a valid text of a kind."""
    return _SAMPLES[kind]()


def _yaml(name: str) -> Callable[[], str]:
    return lambda: (bundled_folder() / name).read_text().replace("urdf: dmu50", f"urdf: {bundled_folder()}/dmu50")


def _small_calibration() -> str:
    return (
        "schema: twin.calibration/1\nmachine: DMU 50 eVolution\nsource: a test\ncurves:\n"
        "  E_XX: {unit: um, domain: [0, 500], basis: power, coefficients: [10.1, 11.4], covariance: [[1, 0], [0, 1]]}\n"
        "  E_ZC: {unit: um, domain: [0, 360], basis: fourier, coefficients: [0, 3.2, -1.1]}\n"
        "squareness: {E_C0Y: 22.0}\nlocation: {E_X0C: 4.0, E_A0C: -12.0}\n"
        "effects:\n  - {effect: reversal, where: Y, parameters: {size: 3}}\n"
        "  - {effect: thermal_growth, where: Z by bed, parameters: {coefficient: 3}}\n"
        "covariance:\n  parameters: ['E_XX[0]', 'E_XX[1]']\n  lower: |\n    1\n    0 1\n"
    )


def _small_columns() -> str:
    with scratch_folder() as folder:
        (folder / "shop.csv").write_bytes(shop_files.cmm_report())
        twin.import_table(folder / "shop.csv", machine()).save_columns(folder / "columns.yaml")
        return (folder / "columns.yaml").read_text()


def _small_table() -> str:
    head = "X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,x_mm,y_mm,z_mm,station,round,time_s,approach_X,T_X_degC,u_x_mm,u_y_mm,u_z_mm\n"
    rows = [
        f"{x},225,-200,0,{x / 2:g},K,tool,{x}.01,2,3,1,{r},{x},1,20.5,0.01,0.01,0.02\n"
        for r in (1, 2)
        for x in range(0, 500, 50)
    ]
    return head + "# a comment\n" + "".join(rows)


def _small_plan() -> str:
    head = "X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,place_x_mm,place_y_mm,place_z_mm,station,planned_station_x_mm,"
    head += (
        "planned_station_y_mm,planned_station_z_mm,planned_station_a_deg,planned_station_b_deg,planned_station_c_deg\n"
    )
    return head + "".join(f"{x},225,-200,0,0,K,tool,1,2,3,1,9,8,7,0,0,0\n" for x in range(0, 500, 50))


def _small_run() -> str:
    at = np.tile(np.concatenate([np.linspace(0, 500, 9), np.linspace(500, 0, 9)]), 2)
    data, _ = simulate_run(
        layout(), machine(), twin.Calibration.default(machine()), at, np.random.default_rng(1),
        rounds=np.repeat(["1", "2"], 18), approach=np.tile(np.repeat([1.0, -1.0], 9), 2),
    )  # fmt: skip
    return data.to_csv(layout(), comment="a test")


def _terms(kind: str) -> Mapping[str, str]:
    nodes = (0.0, 125.0, 250.0, 375.0, 500.0)
    values = (0.0, 1.0, 4.0, 2.0, -3.0)
    terms = tuple(ControlTerm("X", (ControlCurve("X", nodes, values, None, side),)) for side in (1, -1))
    return format_named(kind).write(TableSum(terms, machine()))


def _isg() -> str:
    curves = {i: ControlCurve("X", (0.0, 250.0, 500.0), (0.0, 1.0, -2.0)) for i in range(6)}
    return format_named("isg").write(VolumetricCorrection((AxisErrors("X", curves),), machine(), 120.0))["volcomp.csv"]


def _grid() -> str:
    at = ((0.0, 500.0), (0.0, 450.0), (-400.0, 0.0))
    return format_named("grid").write(CorrectionGrid(machine(), at, np.arange(24.0).reshape(2, 2, 2, 3)))["grid.csv"]


def _identification() -> str:
    misfit = {"rms_um": 3.0, "reduced_chi2": 1.0, "dof": 20, "p_value": 0.4, "lack_of_fit_p_value": None}
    return json.dumps(
        {
            "schema": "twin.identification/1", "machine": "DMU 50 eVolution", "data": "m.csv", "points": {"used": 9, "set_aside": 1},
            "uncertainty": "readings", "errors": [{"name": "E_XX", "order": 2, "peak": 3.0, "value": None}],
            "not_identifiable": [{"name": "E_ZC", "reason": "none"}], "misfit": misfit,
            "set_aside": [{"line": 3, "reason": "none"}], "notices": ["a"], "converged": True,
        },
        indent=1,
    )  # fmt: skip


_SAMPLES: Mapping[str, Callable[[], str]] = {
    "calibration": _small_calibration,
    "machine": _yaml("dmu50.yaml"),
    "kit": _yaml("dmu50.kit.yaml"),
    "layout": lambda: (Path(twin.__file__).parent / "samples" / "nine_beams_x.yaml").read_text(),
    "table": _small_table,
    "plan": _small_plan,
    "import": lambda: shop_files.cmm_report().decode("cp1252"),
    "columns": _small_columns,
    "readings": _small_run,
    "export": lambda: (
        _csv("", np.empty((0, 0))).strip() + "".join(f"{t}{i}, {i}, 2, 3.5\n" for t in "KP" for i in range(3))
    ),
    "points": lambda: _csv("x_mm,y_mm,z_mm,B_deg,C_deg", np.arange(40.0).reshape(8, 5)),
    "siemens": lambda: "".join(_terms("siemens").values()),
    "siemens_eec": lambda: CASES["siemens_eec"].GOOD["eec.mpf"],
    "heidenhain": lambda: next(iter(_terms("heidenhain").values())),
    "isg": _isg,
    "linuxcnc": lambda: _terms("linuxcnc")["X.comp"],
    "ini": lambda: _terms("linuxcnc")["joints.ini"],
    "grid": _grid,
    "identified": _identification,
    "iso": lambda: "%\nG21 G90 G94\nG0 X1 Y2 Z-3\nG1 X10. B3 C4 F500\nG2 X20 Y2 I5 J0\nG91\nG1 X1 (a)\nM30\n%\n",
    "plain language": lambda: (
        "BEGIN PGM A MM\n1 L X+1 Y+2 R0 FMAX\n2 CC X+5 Y+2\n3 C X+9 Y+2 DR+\n4 L B+3 C+4 F500\n5 L IB+3 F500\nEND PGM A MM\n"
    ),
    "apt": lambda: "UNITS/MM\nFEDRAT/MMPM,500\nGOTO/1,2,3,0,0,1\nGOTO/2,2,3,0,0.6,0.8\nRAPID\nGOTO/5,5,5,0,0,1\nFINI\n",
    "urdf": lambda: (bundled_folder() / "dmu50.urdf").read_text(),
    **{form.name: _nominal_kinematics(form.name) for form in kinematics_formats()},
    **{f"measured by {name}": (lambda case=case: case.GOOD) for name, case in MEASURED.items()},
}


def beside(kind: str, folder: Path) -> None:
    """Write the files that are read together with a kind of file."""
    if kind in ("ini", "linuxcnc"):
        files = _terms("linuxcnc")
    elif kind == "heidenhain":
        files = _terms("heidenhain")
    elif kind == "columns":
        files = {"shop.csv": sample("import")}
    else:
        return
    for name, text in files.items():
        (folder / name).write_text(text)


@st.composite
def edited(draw: st.DrawFn, kind: str) -> bytes:
    """Return a text of a kind with parts replaced, doubled, moved or cut."""
    lines = sample(kind).splitlines(keepends=True)
    words = st.sampled_from([*KINDS[kind].words, *NUMBERS, *TEXTS])
    for _ in range(draw(st.sampled_from((1, 1, 2, 3)))):
        at = draw(st.integers(0, len(lines) - 1))
        line = lines[at]
        what = draw(st.sampled_from(("word", "word", "word", "put", "drop", "double", "swap", "cut", "line")))
        if what in ("word", "put"):
            # Replace a word, or insert between two characters.
            places = [i for i, c in enumerate(line) if c in ',: []{}=;"<>\t'] or [0]
            start = draw(st.sampled_from(places)) + 1
            end = next((i for i in places if i >= start), len(line.rstrip("\n"))) if what == "word" else start
            lines[at] = line[:start] + draw(words) + line[end:]
        elif what == "drop":
            del lines[at]
        elif what == "double":
            lines.insert(at, line)
        elif what == "swap":
            other = draw(st.integers(0, len(lines) - 1))
            lines[at], lines[other] = lines[other], lines[at]
        elif what == "cut":
            del lines[at + 1 :]
            lines[at] = line[: draw(st.integers(0, len(line)))]
        else:
            lines.insert(at, draw(words) + "\n")
        lines = lines or ["\n"]
    data = "".join(lines).encode("utf-8", "surrogatepass")
    how = draw(st.sampled_from(("utf-8",) * 12 + ("utf-16", "latin-1", "bytes")))
    if how == "bytes":
        at = draw(st.integers(0, len(data)))
        return data[:at] + draw(st.binary(min_size=1, max_size=8)) + data[at:]
    return data if how == "utf-8" else data.decode("utf-8", "replace").encode(how, "replace")
