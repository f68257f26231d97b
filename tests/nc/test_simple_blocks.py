"""Simple blocks are read and written by a faster path, with exactly the same result as by the general path."""

from __future__ import annotations

import random
import re
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.conftest import beside
from tests.nc.nc_support import AXES, iso_program, plain_program
from twin._common.errors import InputError
from twin.compute.native import compiler
from twin.nc import chunks, dialect_for
from twin.nc.blocks import AxisWords, Kind, NewPositions
from twin.nc.heidenhain import vocabulary as heidenhain_vocabulary

ISO, PLAIN, APT = (dialect_for(Path(name)) for name in ("a.nc", "a.h", "a.cls"))
SWAPPED = AxisWords(("X", "Y", "Z"), ("C", "A"), {"X": 0.001, "Y": 0.005, "Z": 0.0001, "A": 0.001, "C": 0.01})
LONG = AxisWords(("X", "Y", "Z"), ("B1", "C"), dict.fromkeys(("X", "Y", "Z", "B1", "C"), 0.001))
ODD = AxisWords(("X", "Y", "Z"), ("N",), dict.fromkeys("XYZN", 0.001))

GOOD = st.one_of(
    st.integers(-99999, 99999).map(lambda v: f"{v / 1000:.3f}"),
    st.integers(-9999, 9999).map(lambda v: f"{v / 100:g}"),
    st.sampled_from(["0", "-0", "+5", "5.", "00.5", "0.120", "-0.0004", "12.34567", "007", "-0.5", "+0."]),
)
BAD = st.sampled_from(["1234567890", "1.2.3", ".", "", "- 5", "+ 1.5", "5,5", "1e3", ".5", "-.5", "1000000000.5", "+"])
EOL = st.sampled_from(["\n", "\r\n", "\r"])
NO_BLOCKS = heidenhain_vocabulary.SimpleBlocks(re.compile(r"(?!)"))


def rarely(draw, chances=12):
    return draw(st.integers(1, chances)) == chances


@st.composite
def axis_words(draw, names, *, glue=("", " ", "  ", "\t"), plus=False):
    """Draw axis words, mostly in the usual order and well formed."""
    chosen = draw(st.lists(st.sampled_from(names), min_size=1, max_size=5, unique=not rarely(draw, 30)))
    if not rarely(draw):
        chosen = sorted(chosen, key="XYZABCUVW".find)
    numbers = [draw(BAD if rarely(draw, 60) else GOOD) for _ in chosen]
    if plus:
        numbers = [text if text[:1] in ("-", "+") or rarely(draw, 6) else f"+{text}" for text in numbers]
    return draw(st.sampled_from(glue)).join(name + text for name, text in zip(chosen, numbers, strict=True))


ISO_MODES = {
    "absolute": ("", [""]),
    "incremental": ("G91", [""]),
    "inches": ("G20", [""]),
    "inverse time": ("G93", [" F5", " F.5"]),
    "spindle vectors": ("TRAORI\nG1 X1 Y1 Z1", [" A3=0 B3=0 C3=1", " A3=0B3=0.6C3=.8", " B3=1 F5", " C3=2", ""]),
    "vectors": ("G43.5 H1\nG1 X1 Y1 Z1", [" I0 J0 K1", " I0J0.6K.8", " I0 J0 K2 F5", " I1", ""]),
}
ISO_SPECIAL = [
    *("G91", "G90", "G20", "G21", "G94", "G49", "G54", "G53 G0 Z0", "SUPA G0 X1", "G28 Z0", "/X1", "(c)", "G17", "N5"),
    *("G1 F100", "G0", "G1", "%", "", "  ", ";x", "R1=5", "X=R1", "C=DC(10)", "C=ACP(10)", "X=IC(1)", "G4 X1", "M30"),
    *("G1 X1 Y2 M5", "X1 (a)", "G1 X1 S5", "G0 X0 Y0 Z0 B0 C0", "G90 G0 X0 Y0 Z0", "O5", "G1 X1 F5 M8"),
    *("G90 G1 X0 Y0\nG3 X10 Y0 I5 J0\nX0 Y0 I-5 J0", "G2 Z1 I5 J0", "G03 Z2 I0 J3 F5\nZ1 I1 J1", "G3 Z2 I3 J0 TURN=2"),
    *("G90 G1 X0 Y0\nG3 X10 Y1 R20\nX1 Y1 CR=9 F7", "G2 X500 Y3 R-400", "g2 x-5 y3 r400"),
]
ISO_STRANGE = [
    *(
        "G43.4",
        "TRAORI",
        "TRAFOOF",
        "M428",
        "M429",
        "G55",
        "G28",
        "MCALL CYCLE81(10,0,1,-5)\nX5 Y6\nX7",
        "MCALL",
        "G18",
    ),
    *(
        "X1 A3=0 B3=0 C3=1",
        "X1 =5",
        "N1 N2",
        "FOO",
        "G2 X9 Y9 I1 J1",
        "X1 R5",
        "G3 X1",
        "X1 I0 J0 K1",
        "G43.5",
        "G2 B5 R3",
    ),
]


def lines_of(draw, plain, special, strange, most=20):
    """Draw lines of a program: simple ones, others, and a few unusual ones."""
    lines = []
    for _ in range(draw(st.integers(1, most))):
        if rarely(draw, 60):
            lines.append(draw(st.sampled_from(strange)))
        else:
            lines.append(draw(st.sampled_from(special)) if rarely(draw, 5) else plain())
    return lines


@st.composite
def mixed_iso(draw, names=AXES.names):
    """Draw simple and other blocks, with modal words that change the meaning of simple blocks."""
    mode = draw(st.sampled_from(sorted(ISO_MODES)))
    setting, tails = ISO_MODES[mode]
    upright = names[:3] if "vectors" in mode else names
    spaced = draw(st.sampled_from([(" ",), ("",), ("", " ", "\t")]))
    tail = st.sampled_from([*tails, *tails, " F500", "F.5", " F1.5", "\t"])

    def plain():
        head = draw(st.sampled_from(["", "", "N10 ", "N10", "n7\t", " "]))
        code = draw(st.sampled_from(["", "", "G1", "G0 ", "G01 ", "g1", "G00"]))
        text = head + code + draw(axis_words(upright, glue=spaced)) + draw(tail)
        return text.lower() if rarely(draw) else text

    start = [f"G0 X0 Y0 Z0{''.join(f' {name}0' for name in names[3:])}"]
    lines = lines_of(draw, plain, ISO_SPECIAL, ISO_STRANGE)
    eol = draw(EOL)
    text = eol.join([*([] if rarely(draw) else start), setting, *lines]) + draw(st.sampled_from([eol, ""]))
    return text


PLAIN_SPECIAL = [
    *("L Z+0 R0 FMAX M91", "CC X+0 Y+0", "L M30", "X+5", "; c", "Q1 = +5", "L X+Q1", "CYCL DEF 32.0 ~", "", "M140"),
    *("L X+1 M5", "L X+1 ; c", "CYCL DEF 200 ~\nQ1=+1", "END PGM a MM", "TOOL CALL 1 Z", "L IX+1 Y+2", "L F500"),
    *("L X+0 Y+0 Z+0 B+0 C+0 FMAX", "L X+0 Y+0\nCC X+5 Y+0\nC X+10 Y+0 DR+", "CR X+1 Y+1 R+400 DR-", "L X+1 F1.2.3"),
    "LN X+1 NX+0 NY+0 NZ+2",
]
PLAIN_STRANGE = [
    "M128",
    "M129",
    "FOO",
    "L X+1 Y+2 RL F100",
    "C X+5 Y+5 DR+",
    "FUNCTION RESET TCPM",
    "LX+1",
    "L X+1 TX+1",
]


@st.composite
def mixed_plain(draw):
    """Draw the same in Heidenhain plain language."""
    tcp = draw(st.booleans())
    comma = draw(st.booleans())
    tilts = ["", " TX+0 TY+0.6 TZ+0.8", " NX+0 NY+0 NZ+1 TX+0 TY+0 TZ+1", " NZ-2", " TX+1", " TY-1 TZ+2"]

    def plain():
        tilt = draw(st.sampled_from(tilts)) if tcp and draw(st.booleans()) else ""
        keyword = draw(st.sampled_from(["LN ", "ln ", "LN\t"] if tilt else ["L ", "L ", "l ", "L\t"]))
        tail = draw(st.sampled_from(["", " R0", " R0 FMAX", " F500", "F MAX", " fmax", " F1.5", " R0F50", " R0 F5."]))
        names = AXES.names[:3] if tilt else AXES.names
        text = keyword + draw(axis_words(names, glue=(" ", " ", "", "\t"), plus=True)) + tilt + tail
        return text.replace(".", ",") if comma or rarely(draw) else text

    start = [
        "BEGIN PGM a " + draw(st.sampled_from(["MM", "INCH"])),
        *(["M128"] if tcp else []),
        "L X+1 Y+1 Z+1 B+1 C+1",
    ]
    lines = [*([] if rarely(draw) else start), *lines_of(draw, plain, PLAIN_SPECIAL, PLAIN_STRANGE)]
    if draw(st.booleans()):
        lines = [f"{i} {text}" for i, text in enumerate(lines)]
    eol = draw(EOL)
    return eol.join(lines) + draw(st.sampled_from([eol, ""]))


CYCLES = [
    *(
        "G81 X1 Y1 Z-5 R2 F300",
        "G99 G81 X1 Y1 Z-5 R2",
        "G98 G82 X1 Y1 Z-5 R2 P0.5",
        "G83 X1 Y1 Z-7 R2 Q3",
        "G73 X1 Z-4 R1 Q1.5",
    ),
    *(
        "G85 X1 Y1 Z-3 R2",
        "G99 G89 X1 Z-3 R2 P1",
        "G84 X1 Z-9 R3",
        "MCALL CYCLE81(10,0,2,-5)",
        "MCALL CYCLE82(10.,0.,3.,-6.,,0.5)",
    ),
    *(
        "MCALL CYCLE83(10,0,1,-9,,-3,,0,0,0,1,1)",
        "MCALL CYCLE85(10,0,2,-5,,0.5,80,120)",
        "MCALL CYCLE84(10,0,2,-5,,0.5,3,,0.8)",
    ),
]


@st.composite
def drilled(draw):
    """Draw drilling cycles with the places of holes, mostly simple lines, some of them split by other words."""
    eol, small = draw(EOL), rarely(draw, 6)
    number = st.integers(-99999, 99999).map(lambda v: f"{v / 1000:.3f}")
    lines = ["G0 X0. Y0. Z20. B0. C0."]
    for _ in range(draw(st.integers(1, 3))):
        lines.append(draw(st.sampled_from(CYCLES)))
        for _ in range(draw(st.integers(1, 12))):
            if rarely(draw, 15):
                lines.append(
                    draw(st.sampled_from(["", "(c)", "X1 Z3", "X1 M8", "X1Y2", "G99", "N5 X7 F200", "X1 Y1 R3 Z-4"]))
                )
            else:
                glue = "" if rarely(draw, 12) else " "
                names = draw(st.sampled_from([("X",), ("Y",), ("X", "Y"), ("X", "Y"), ("X", "Y"), ("X", "Y", "C")]))
                lines.append(glue.join(f"{name}{draw(number)}" for name in names))
        lines.append(draw(st.sampled_from(["G80", "MCALL", "", "G80 G0 Z20"])))
    text = eol.join(lines) + draw(st.sampled_from([eol, ""]))
    return text.lower() if small else text


@st.composite
def long_runs_plain(draw):
    """Draw programs in plain language that are nearly all simple blocks in capitals: long runs, some with decimal commas."""
    comma, numbered = draw(st.booleans()), draw(st.booleans())
    eol = draw(EOL)

    def plain():
        if rarely(draw, 20):
            return draw(
                st.sampled_from(
                    ["", " ", "; c", "* - section", "L", "L R0", "X+1", "L Y+2.5 M8", "l x+1", "L F500 X+1"]
                )
            )
        tail = draw(
            st.sampled_from(["", "", " R0", " R0 FMAX", " F500", "\tFMAX", " F1.5 ", " R0 F5.", " FMAX R0", " R0 R0"])
        )
        text = "L " + draw(axis_words(AXES.names, glue=(" ", " ", "\t", "  "), plus=True)) + tail
        return text.replace(".", ",") if comma else text

    start = ["BEGIN PGM a MM", "L X+1 Y+1 Z+1 B+1 C+1"]
    lines = [*start, *(plain() for _ in range(draw(st.integers(1, 30))))]
    if numbered:
        first = draw(st.sampled_from([0, 7, 95]))
        width = draw(st.sampled_from([0, 0, 4]))
        lines = [f"{i:0{width}d} {text}" for i, text in enumerate(lines, first)]
    return eol.join(lines) + draw(st.sampled_from([eol, ""]))


@st.composite
def mixed_apt(draw):
    """Draw cutter locations: simple statements and others."""
    eol = draw(EOL)
    usual = st.integers(-99999, 99999).map(lambda v: f"{v / 1000:.4f}")
    strange = st.sampled_from(
        ["0", "-0.0", "5", "-5.", ".5", "+1.5", "1.5E1", "2D0", " 3.5", "1.123456789", "-0.000001", "-.0"]
    )
    numbers = st.one_of(usual, usual, usual, strange) if draw(st.booleans()) else usual
    vectors = [
        "0,0,1",
        "0.000000,0.600000,0.800000",
        "0.6,-0.0,0.8",
        "0,0.5,0.5",
        "-1,0,0",
        ".6,0,.8",
        "0.0,0.7071068,0.7071068",
    ]

    def location():
        head = draw(st.sampled_from(["GOTO/"] * 9 + ["GOTO / ", "goto/", " GOTO/"]))
        words = [draw(numbers) for _ in range(3)]
        tilt = draw(st.sampled_from(["", *vectors])) if draw(st.booleans()) else vectors[1]
        tail = draw(st.sampled_from([""] * 9 + [" ", "\t", " $$ here"]))
        return head + ",".join([*words, *([tilt] if tilt else [])]) + tail

    special = [
        "RAPID",
        "FEDRAT/500",
        "UNITS/INCHES",
        "UNITS/MM",
        "$$ note, GOTO/1,2,3",
        "",
        " ",
        "%",
        "(x)",
        "PAINT/COLOR,1",
        "X1",
    ]
    special += [
        "FROM/1,2,3",
        "GOTO/1,2,$",
        "GOTO/1,2,3,0,0,2",
        "GOTO/1,2,3,0,0.8,0.59",
        f"GOTO/1,$ {eol} 2,3,0,0,1",
        "N10 GOTO/1,2,3",
    ]
    lines = [
        location() if draw(st.integers(0, 6)) else draw(st.sampled_from(special))
        for _ in range(draw(st.integers(1, 25)))
    ]
    return eol.join(["UNITS/MM", "GOTO/0,0,0,0,0,1", *lines]) + draw(st.sampled_from([eol, ""]))


def shown(reading):
    """Return an interpretation in comparable form (NaN equals NaN, sets are sorted)."""
    return [repr(move._replace(named=tuple(sorted(move.named)))) for move in reading.moves], repr(reading.notices)


def outcome(work):
    """Return the result of a function, or its error as text."""
    try:
        return work()
    except InputError as error:
        return f"refused: {error}"


def new_positions(reading, seed, width):
    """Return new positions of most moves: shifted or not, in one or more segments, with tool vectors or without."""
    choice = random.Random(seed)
    tilted = choice.random() < 0.7
    most = choice.choice([1, 1, 2, 3])
    kept = choice.choice([0.0, 0.15, 0.5])
    lean = choice.choice([0, 0, 1])
    new = {}
    for index, move in enumerate(reading.moves):
        if move.machine or choice.random() < kept:
            continue
        size = choice.choice([0.0, 0.0004, 0.05, 7.0])
        segments = choice.randint(1, most)
        rows = np.array([[v + size * choice.uniform(-1, 1) for v in move.position] for _ in range(segments)])
        if choice.random() < 0.05:
            rows[:, choice.randrange(width)] = np.nan
        vectors = None
        if move.vector is not None and tilted:
            vectors = np.array([move.vector] * segments) + 0.01 * choice.randint(0, lean)
            vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
        new[index] = (rows, vectors)
    return NewPositions.of(len(reading.moves), width, new)


@contextmanager
def way(name):
    """Read and write token by token, by the pattern of simple blocks (plain language), or all simple blocks of a run together."""
    with pytest.MonkeyPatch.context() as patch:
        if name == "tokens":
            patch.setattr(heidenhain_vocabulary, "simple_pattern", lambda names: NO_BLOCKS)
        patch.setattr(chunks, "SHORTEST_RUN", 1 if name in ("runs", "compiled") else 10**9)
        patch.setattr(compiler, "WORTH_COMPILING", 1 if name == "compiled" else 10**9)
        yield


def by_every_way(work):
    """Yield the outcome of a function by each path."""
    for name in ("tokens", "plain", "runs", "compiled"):
        with way(name):
            yield outcome(work)


def check(dialect, text, seed, axes=AXES, *, tcp=False):
    program = dialect.read(text.encode("latin-1"), "test")
    general, *others = by_every_way(lambda: dialect.moves(program, axes, tcp=tcp))
    if any(isinstance(reading, str) for reading in (general, *others)):
        assert all(reading == general for reading in others)
        return
    assert all(shown(reading) == shown(general) for reading in others)
    new = new_positions(general, seed, len(axes.names))
    first, *others = by_every_way(lambda: dialect.rewrite(program, axes, general, new))
    assert all(text == first for text in others)


SEED = st.integers(0, 10**6)
MANY = settings(max_examples=200)


@pytest.mark.slow
@MANY
@given(text=st.one_of(mixed_iso(), iso_program()), seed=SEED, tcp=st.booleans())
@example(text="G0 X0 Y0 Z0\nMCALL CYCLE81(10,0,1,-5)\nX5 Y5\n", seed=1, tcp=False)
def test_iso(text, seed, tcp):
    if text.strip():
        check(ISO, text, seed, tcp=tcp)


@pytest.mark.slow
@settings(max_examples=150)
@given(data=st.data(), seed=SEED, axes=st.sampled_from([SWAPPED, LONG, ODD]))
def test_iso_on_other_machines(data, seed, axes):
    text = data.draw(mixed_iso(names=("X", "Y", "Z", *(name for name in axes.rotary if len(name) == 1))))
    if text.strip():
        check(ISO, text, seed, axes)


@pytest.mark.slow
@MANY
@given(text=st.one_of(mixed_plain(), plain_program()), seed=SEED, tcp=st.booleans())
def test_plain_language(text, seed, tcp):
    if text.strip():
        check(PLAIN, text, seed, tcp=tcp)


@pytest.mark.slow
@MANY
@given(text=drilled(), seed=SEED)
def test_drilling(text, seed):
    check(ISO, text, seed)


@pytest.mark.sample(13)  # of 39
@pytest.mark.parametrize("cycle", CYCLES)
@pytest.mark.parametrize(
    "places", ["X1 Y2\nX3. Y4.5\nY5\nX6 Y7\n", "X1Y2\nX3.Y4.5\nX6Y7\n", "X1 Y2\n\nX3. Y4.5\n(c)\nX6 Y7\n"]
)
def test_each_drilling_cycle(cycle, places):
    text = f"G0 X0. Y0. Z20. B0. C0.\n{cycle}\n{places}G80\nMCALL\nX1 Y1\n"
    for seed in range(30):
        check(ISO, text, seed)


@pytest.mark.slow
@MANY
@given(text=long_runs_plain(), seed=SEED)
def test_long_runs_of_plain_language(text, seed):
    check(PLAIN, text, seed)


@pytest.mark.slow
@MANY
@given(text=mixed_apt(), seed=SEED)
@example(text="GOTO/0,0,0,0,0,1\nGOTO/1,2,$\nGOTO/1,2,3\nGOTO/4,5,6\n", seed=1)
def test_locations(text, seed):
    check(APT, text, seed)


def test_no_negative_zero_in_locations():
    program = APT.read(b"GOTO/0.0,0.0,0.000000,0,0,1\n" * 3, "test")
    reading = APT.moves(program, AXES, tcp=True)
    rows = np.array([[-1e-9, -0.0, -4e-7, np.nan, np.nan], [-0.0, -2e-5, 1.0, np.nan, np.nan]])
    tools = np.array([[-1e-12, -0.0, 1.0], [-1e-9, 0.0, 1.0]])
    new = NewPositions.of(3, 5, {i: (rows, tools) for i in range(3)})
    first, *others = by_every_way(lambda: APT.rewrite(program, AXES, reading, new))
    assert "-0.00000," not in first and "-0.00002,1.000000,-0.000000001,0,1\n" in first
    assert all(text == first for text in others)


@pytest.mark.parametrize("name", ["tokens", "plain", "runs"])
def test_fmax_is_a_rapid_of_its_own_block(name):
    """Heidenhain: FMAX applies to its block only, any other feed until the next; both readers must distinguish them."""
    lines = {
        "L X+0 Y+0 Z+0 B+0 C+0 R0 FMAX": Kind.RAPID,
        "L X+1 R0 F500": Kind.LINEAR,
        "L X+2 R0 F MAX": Kind.RAPID,
        "L X+3": Kind.LINEAR,
        "L Y+1 FMAX M3": Kind.RAPID,
        "L Y+2 F1.5": Kind.LINEAR,
        "l y+3 fmax": Kind.RAPID,
        "L X+4 F AUTO": Kind.LINEAR,
        "L Z-5 FMAX": Kind.RAPID,
    }
    text = "BEGIN PGM A MM\n" + "\n".join(lines) + "\nEND PGM A MM\n"
    program = PLAIN.read(text.encode(), "a.h")
    with way(name):
        reading = PLAIN.moves(program, AXES, tcp=False)
    assert [move.kind for move in reading.moves] == list(lines.values())
    # Most of these blocks are simple, and take the faster path if it is enabled.
    pattern = heidenhain_vocabulary.simple_pattern(AXES.names).pattern
    assert sum(pattern.fullmatch(f"{line}\n") is not None for line in lines) >= 5


HANDED_ON = {
    "motion words and their width": (
        ISO,
        "G00 X0 Y0 Z0 B0 C0\nG02 X9 Y0 R9\nX0 R9\nX9 R9\nG01 X1\nX2\nG3 X5 R7\nX0 R9\n",
    ),
    "short motion words": (ISO, "g0 x0 y0 z0 b0 c0\ng2 x9 y0 r9\nx0 r9\nx9 r9\ng1 x1\nx2 M8\ng3 x5 r7\nx0 r9\n"),
    "spaces": (ISO, "G0X0Y0Z0B0C0\nG1 X1 Y2\nG1X3\nN5 M3\nX4\nN6X5 M8\nN7 X4 M8\nN8Y5\n"),
    "styles": (ISO, "G0 X0. Y0 Z0 B0 C0\nX1.50\nY.5 M8\nX+2\nZ3 M8\nX4\nY5. M8\nX-.5\nZ1 M8\nX1.25\n"),
    "a second work offset": (ISO, "G54 G0 X0 Y0 Z0 B0 C0\nG55\nX1\nX2\n"),
    "a work offset, then another": (ISO, "G0 X0 Y0 Z0 B0 C0\nG54\nX1\nX2\nG55\nX2 M8\n"),
    "vectors": (ISO, "G43.5 G1 X0 Y0 Z0\n" + "X1 I0 J0 K1\nX2\nX3 I0 J0 K1\nX4 I0 J0 K1 M8\nX5\n" * 3),
    "vectors and rotary axes": (
        ISO,
        "G43.5 G1 X0 Y0 Z0\n" + "X1 I0 J0 K1\nX2\nX3 B0 C0\nX3 I0 J0 K1\nX5 B0 C0 M8\n" * 3,
    ),
    "spindle vectors": (ISO, "TRAORI\nG1 X0 Y0 Z0\n" + "X1 A3=0 B3=0 C3=1\nX2\nX3 A3=0 B3=0 C3=1\nX4 M8\nX5 C0\n" * 3),
    "drilling": (ISO, "G0 X0 Y0 Z20\nMCALL CYCLE81(10,0,1,-5)\nX5 Y5\nX6\nMCALL\nX7 Y7 Z7\nX8\n"),
    "inverse time": (ISO, "G0 X0 Y0 Z0 B0 C0\nG93\nG1 X5 F3\nX6 F4\nG94\nX7 F500\nX8\n"),
    "incremental": (ISO, "G0 X0 Y0\nG91 G1 X1\nX.0004\nY.0004\nX.0004 M8\nX1\nG90 X1\nX2\n"),
    "skipped blocks": (ISO, "G0 X0 Y0 Z0 B0 C0\nG1 X1\n/X2\nX3\nX4\n/G0 X5\nX6\n"),
    "tool vectors": (
        PLAIN,
        "M128\n" + "LN X+1 TX+0 TY+0 TZ+1\nL X+2\nL X+3 B+1\nLN X+1 TX+0 TY+0 TZ+1 M8\nL X+4\n" * 3,
    ),
    "renumbering": (PLAIN, "0 L X+0 Y+0 Z+0\n1 L X+5 FMAX\n2 L X+7 M3\n; c\n3 L Y+5,5\n"),
    "letters": (PLAIN, "l x+0 y+0 z+0\nL X+5\nl x+7 m3\nL Y+5\nL X+1 M8\n"),
}


@pytest.mark.sample(6)  # of 16
@pytest.mark.parametrize("name", HANDED_ON)
def test_what_one_way_leaves_to_the_other(name):
    """Modal state and formatting are passed between simple and other blocks, in both directions."""
    dialect, text = HANDED_ON[name]
    for seed in range(60):
        check(dialect, text, seed)


@pytest.mark.sample(1)  # of 3
@pytest.mark.parametrize("suffix", [".txt", ".mpf", ".ngc"])
def test_programs_of_others(suffix):
    (path,) = beside("data", "programs").glob(f"*{suffix}")
    for seed in range(3):
        check(ISO, path.read_bytes().decode("latin-1"), seed)


def test_what_is_plain():
    """The pattern does match; otherwise every other test here would pass without the faster path."""
    plain = heidenhain_vocabulary.simple_pattern(AXES.names).pattern
    yes = ["L X+1\n", "10 L X+1,5 Y-2 R0 FMAX", "l c+5 F500", "LN X+1 TX+0 TY+0 TZ+1"]
    no = ["L", "L F5", "LX+1", "L IX+1", "L X+1 M3", "L X+Q1", "C X+1 DR+", "L X+1 RL", "X+1", "L X+1 ~"]
    assert [text for text in yes if not plain.fullmatch(text)] == []
    assert [text for text in no if plain.fullmatch(text)] == []


def test_lines_with_nothing_but_motion():
    """Positions, paths, tool vectors and feeds may be thinned out together; lines with anything else stay."""
    yes = ["G1 X1.5\n", "X1", "N10G01X-.5Y+5.F500\r\n", "x1 c2", "G2 X1 Y1 I5 J0", "G1 X1 TURN=1", "X1 A3=0 B3=0 C3=1"]
    no = ["X1 M3", "X1 (c)", "X1 ;c", "G91 X1", "G4 F1", "/X1", "X=IC(5)", "X#1", "X1.2.3", "X1 S500", "X1 A1", "R1=5"]
    assert [text for text in yes if not ISO.is_motion_only(text, AXES.names)] == []
    assert [text for text in no if ISO.is_motion_only(text, AXES.names)] == []
