"""Command ``twin machine``."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from twin._common.bundled import find_bundled
from twin._common.errors import InputError
from twin._common.families import Language
from twin._common.files import check_writable, scratch_folder, write_atomic
from twin._common.messages import Message, Number, joined, say
from twin.cli.shared import complete
from twin.cli.shared.command import CALIBRATION, EXISTING, HTML, POSITIVE, CommandResult, JsonOption, command
from twin.cli.shared.paper import LangOption
from twin.cli.shared.terminal import echo, pairs, three_numbers

if TYPE_CHECKING:
    from twin.controls.described import StatedKinematics
    from twin.machine.description import Description
    from twin.machine.machine import Machine
    from twin.machine.statements import AxisStatement, Displayed

SCHEMA: Final = "twin.machine-check/1"
KINDS: Final[Mapping[str, tuple[str, str, str, Mapping[str, str]]]] = {
    "1": (Message("trunnion A with table C, fixed bridge"), "X Z", "Y A C", {}),
    "2": (Message("trunnion B with table C, gantry"), "Y X Z", "B C", {}),
    "3": (Message("nutating table B (45°) with table C"), "X Y Z", "B C", {"B": "0 1 -1"}),
    "4": (Message("head B, table C"), "Y Z B", "X C", {}),
    "5": (Message("fork head C A, gantry"), "X Y Z C A", "", {}),
    "6": (Message("head C B, gantry"), "X Y Z C B", "", {}),
    "7": (Message("nutating head B (45°), table C"), "X Y Z B", "C", {"B": "0 1 1"}),
    "8": (Message("four axes: rotary table A"), "Z", "X Y A", {}),
    "9": (Message("three axes, mill with a cross table"), "Z", "X Y", {}),
    "10": (Message("three axes, router with a gantry"), "Y X Z", "", {}),
    "11": (Message("three axes, printer with a moving bed"), "Z X", "Y", {}),
    "12": (Message("horizontal machining centre, rotary table B"), "X Y", "Z B", {"spindle": "horizontal"}),
    "13": (Message("horizontal machining centre, tilting table A B"), "X Y Z", "A B", {"spindle": "horizontal"}),
}
"""Kinds of machine that are offered: name, axes of the tool and of the workpiece from the bed outwards, and inclined axes."""
RANGES: Final = {"X": "0 500", "Y": "0 400", "Z": "-400 0", "A": "-120 30", "B": "-110 110", "C": "unlimited"}


MADE: Final = "made by `twin machine new`"
"""Mark of the files that may be replaced."""


class Action(StrEnum):
    """Task of the command."""

    new = "new"
    check = "check"


@command(
    "twin machine new -o mill.yaml",
    "twin machine new --lang de -o fraesmaschine.yaml",
    "twin machine new --answers answers.yaml -o mill.yaml --html mill.html",
    "twin machine new --control axes.ini --control kins.hal --keep answers.yaml -o mill.yaml",
    "twin machine check mill.yaml --control archive.mpf --positions five.csv --tool-length 120",
    "twin machine check mill.yaml --no 4 5",
)
def machine(
    action: Annotated[Action, typer.Argument(help="new: describe a machine; check: check the files of one.")],
    file: Annotated[
        str | None,
        typer.Argument(
            metavar="[MACHINE]", help="With check: machine file, or a bundled name.", autocompletion=complete.machines
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Machine file to write; its .urdf and .answers.yaml are written beside."),
        CALIBRATION,
    ] = None,
    answers: Annotated[
        Path | None, typer.Option("--answers", help="YAML file of answers (twin doc machine); no questions."), EXISTING
    ] = None,
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="One answer: axes.B.at='nose 0 0 180'; repeatable.")
    ] = None,
    ask: Annotated[bool, typer.Option("--ask", help="Ask for what --answers and --set do not give.")] = False,
    keep: Annotated[
        Path | None, typer.Option("--keep", help="Keep the answers here, also if interrupted."), CALIBRATION
    ] = None,
    control: Annotated[
        list[Path] | None,
        typer.Option("--control", help="Files with the control's kinematics: SINUMERIK, Fanuc, HEIDENHAIN, LinuxCNC."),
        EXISTING,
    ] = None,
    positions: Annotated[
        Path | None,
        typer.Option("--positions", help="With check: CSV of axis positions and displayed x, y, z (i, j, k)."),
        EXISTING,
    ] = None,
    no: Annotated[
        list[int] | None, typer.Option("--no", help="With check: numbers of the statements that are not true.")
    ] = None,
    tool_length: Annotated[
        float | None, typer.Option("--tool-length", help="Length of the tool at --positions, mm; default: the file's.")
    ] = None,
    work_origin: Annotated[
        str | None,
        typer.Option("--work-origin", help="Zero x,y,z of --positions in the work frame, mm; default: fitted."),
    ] = None,
    tolerance: Annotated[
        float, typer.Option("--tolerance", help="Largest difference from the control, mm and degrees."), POSITIVE
    ] = 0.01,
    html_file: Annotated[
        Path | None, typer.Option("--html", help="Draw the statements in this HTML file."), HTML
    ] = None,
    json_file: JsonOption = None,
    lang: LangOption = Language.en,
) -> CommandResult:
    """Describe your own machine by answers, without programming, or check a machine against its control.

    `new` asks, with defaults, or reads a YAML file, and writes the machine file, a URDF with plain solids, and the answers. Both print
    statements to be checked at the machine; a "no" (--no) names the answer that it contradicts. The answers: `twin doc machine`.
    """
    of_check = {"MACHINE": file, "--positions": positions, "--no": no, "--work-origin": work_origin}
    of_new = {"--output": output, "--answers": answers, "--set": setting, "--keep": keep}
    for name, value in (of_check if action is Action.new else of_new).items():
        if value:
            raise InputError(
                f"{name} is not for {action.value}", expected=f"twin machine {action.value} --help", value=value
            )
    if action is Action.check:
        if file is None:
            raise InputError("no machine given", expected="twin machine check MACHINE")
        path = find_bundled(file, ".yaml", "a machine file")
        return _check(path, control or [], positions, no or [], tool_length, work_origin, tolerance, html_file, lang)
    if output is None:
        raise InputError("no output given", expected="-o mill.yaml")
    if tool_length is not None:
        setting = [*(setting or []), f"tool_length={tool_length!r}"]
    return _new(output, answers, setting or [], ask, keep, control or [], html_file, lang)


# --- twin machine new --------------------------------------------------------------------------------


def _new(
    output: Path,
    answers: Path | None,
    setting: list[str],
    ask: bool,
    keep: Path | None,
    control: list[Path],
    html: Path | None,
    language: Language,
) -> CommandResult:
    """Write the files of a described machine, and report its statements."""
    urdf, answers_file = output.with_suffix(".urdf"), output.with_suffix(".answers.yaml")
    same = answers is not None and answers.resolve() == answers_file.resolve()
    kept = keep is not None and keep.resolve() == answers_file.resolve()
    check_writable([urdf] if same or kept else [urdf, answers_file])
    for path in (output, urdf):
        # The URDF is not named on the command line, and either may be written by hand.
        if path.exists() and MADE not in path.read_bytes()[:1000].decode(errors="replace"):
            raise InputError(f"exists, and was not {MADE}", expected="another name for -o", file=path)
    from twin._common.yaml_files import yaml_text
    from twin.machine.description import SCHEMA as ANSWERS
    from twin.machine.description import Description
    from twin.machine.machine import Machine

    data = _given(answers, setting)
    stated = None
    if control:
        from twin.controls.described import StatedKinematics

        stated = StatedKinematics.load(control)
    try:
        data = _answered(data, stated, ask=ask or (answers is None and not setting))
    finally:
        if keep is not None and data:
            write_atomic(keep, yaml_text({"schema": ANSWERS, **data}))
    direct = answers is not None and not (setting or control or ask)
    description = Description.load(answers) if direct and answers is not None else Description.of(data)
    texts = {urdf: description.urdf(), output: description.machine_file(urdf.name, answers_file.name)}
    with scratch_folder() as folder:
        for path, text in texts.items():
            (folder / path.name).write_text(text, encoding="utf-8")
        made = Machine.load(folder / output.name)
        description.check(made)
        found = _Statements(made, language)
        page = found.page()
    if not same:
        texts[answers_file] = yaml_text({"schema": ANSWERS, **data})
    if html is not None:
        texts[html] = page
    for path, text in texts.items():
        write_atomic(path, text)
    lines = [*found.lines(), "", *_assumed(data, description), *_unchecked(stated)]
    report = {
        **found.to_dict(),
        "machine": str(output),
        "urdf": str(urdf),
        "unchecked": list(stated.unchecked) if stated else [],
    }
    draw = Message("Draw it: {command}", command=f"twin scene PROGRAM -o scene.html --machine {output}")
    return CommandResult(joined("\n", [*lines, ""]), lambda: report, files=list(texts), after=[draw])


def _given(answers: Path | None, setting: Sequence[str]) -> dict[str, Any]:
    """Return the plain answers of a file and of `--set`."""
    import yaml

    from twin._common.yaml_files import read_yaml
    from twin.machine.description import SCHEMA as ANSWERS

    data: dict[str, Any] = {}
    if answers is not None:
        read, _ = read_yaml(answers)
        if not isinstance(read, dict) or read.get("schema") != ANSWERS:
            raise InputError("not a file of answers", expected=f"schema: {ANSWERS}", file=answers)
        data = {key: value for key, value in read.items() if key != "schema"}
    for name, text, entry in pairs("--set", setting, "ANSWER=value: axes.B.range='[-110, 110]'"):
        place: Any = data
        *above, last = name.split(".")
        for key in above:
            place = place.setdefault(key, {}) if isinstance(place, dict) else None
        try:
            value = yaml.safe_load(text)
        except yaml.YAMLError:
            value = text
        if not isinstance(place, dict):
            raise InputError("--set names no answer", expected="a name of `twin doc machine`", value=entry)
        if isinstance(place.get(last), type(None)) or place[last] == value:
            place[last] = value
        else:
            raise InputError(f"--set contradicts `{name}`", expected=f"{place[last]}, or no such answer", value=entry)
    _check_shape(data)
    return data


def _check_shape(data: Mapping[str, Any]) -> None:
    """Raise `InputError` unless answers that may still be incomplete are lists and entries where such are expected."""
    axes, table = data.get("axes") or {}, data.get("table") or {}
    ranges = [one.get("range") for one in axes.values() if isinstance(one, dict)] if isinstance(axes, dict) else [0]
    for key, fits, expected in (
        *((side, _is_names(data.get(side) or []), "a list of axes: [X, Y, Z]") for side in ("tool", "work")),
        (
            "table",
            isinstance(table, dict) and all(map(_is_number, table.values())),
            "positions: {X: 250, Y: 200, Z: -400}",
        ),
        ("axes", isinstance(axes, dict) and len(ranges) == len(axes), "entries: {X: {range: [0, 500]}}"),
        (
            "axes",
            all(one in (None, "unlimited") or _is_pair(one) for one in ranges),
            "range: [lower, upper] or unlimited",
        ),
    ):
        if not fits:
            raise InputError(f"`{key}` cannot be read", expected=expected, value=data.get(key))


def _is_names(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(name, str) and name[:1] in tuple("XYZABC") for name in value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_pair(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(_is_number, value))


def _answered(data: dict[str, Any], stated: StatedKinematics | None, *, ask: bool) -> dict[str, Any]:
    """Return the answers, completed from the control and by questions; filled in place, so that what was answered is not lost."""
    hints = _ask_chain(data, stated) if ask else {}
    if stated is not None:
        completed = stated.completed(data)
        data.update(completed)
    if ask:
        _ask_axes(data, hints)
    return data


def _question(text: str, default: str, parse: Callable[[str], Any], expected: str) -> Any:
    """Ask until the answer can be read; an empty one is the default.

    Raises:
        InputError: the input ends.
    """
    while True:
        echo(f"{say(text)}{f' [{default}]' if default else ''}: ", end="")
        sys.stdout.flush()
        line = sys.stdin.readline()
        if not line:
            raise InputError("the answers end here", expected=f"{text}: {expected}")
        value = parse(line.strip() or default)
        if value is not None:
            return value
        echo("  " + say("expected {expected}", expected=expected))


def _ask_chain(data: dict[str, Any], stated: StatedKinematics | None) -> dict[str, str]:
    """Ask for the name and the order of the axes, where they are not given; return the directions of inclined axes of that kind."""
    from twin.machine.description import NAME, check_chain

    hints: dict[str, str] = {}

    def chain(text: str) -> list[str] | None:
        names = [] if text == "-" else text.upper().replace(",", " ").split()
        return names if all(re.match(NAME, name) for name in names) else None

    if "name" not in data:
        data["name"] = _question(
            Message("Name of the machine"), "my machine", lambda text: text[:80], Message("a name")
        )
    if stated is not None:
        data.update({key: list(names) for key, names in stated.chains.items() if names and key not in data})
    if "tool" not in data and "work" not in data:
        for key, (name, tool, work, _) in KINDS.items():
            text = say("{name}: tool {tool}; workpiece {work}", name=name, tool=tool or "-", work=work or "-")
            echo(f"  {key}  {text}")
        kind = _question(
            Message("Which is closest"),
            "1",
            lambda text: KINDS.get(text),
            Message("one of {names}", names=" ".join(KINDS)),
        )
        hints.update(kind[3])
        if "spindle" in hints:
            data.setdefault("spindle", hints.pop("spindle"))
        while "tool" not in data:
            found = {}
            for key, what, default in (("tool", Message("tool"), kind[1]), ("work", Message("workpiece"), kind[2])):
                text = Message("Axes that move the {what}, from the bed outwards (- for none)", what=what)
                found[key] = _question(text, default or "-", chain, Message("letters X Y Z A B C, separated by blanks"))
            try:
                check_chain(found["tool"], found["work"])
                data.update(found)
            except InputError as error:
                echo(f"  {error}")
    return hints


def _ask_axes(data: dict[str, Any], hints: Mapping[str, str]) -> None:
    """Ask for what is missing about every axis, the place of the table and the tool."""
    from twin.machine.description import is_linear

    axes, lying = data.setdefault("axes", {}), data.get("spindle") == "horizontal"
    tool, work = list(data.get("tool") or ()), list(data.get("work") or ())
    for name in sorted((*tool, *work), key=lambda name: (not is_linear(name), name)):
        unit, one = ("mm" if is_linear(name) else Message("degrees")), axes.setdefault(name, {})
        parse = _reach if is_linear(name) else _turns
        _ask(
            one,
            "range",
            Message("{name}: range, {unit}", name=name, unit=unit),
            "unlimited" if lying and name[0] == "B" else RANGES[name[0]],
            parse,
            Message("lower upper with zero inside, or unlimited") if unit == "degrees" else Message("lower upper"),
        )
    if not any("increment" in one for one in axes.values()):
        least = _question(
            Message("Least increment of all axes, mm and degrees"), "0.001", _single, Message("a number above 0")
        )
        for one in axes.values():
            one["increment"] = least
    table = data.setdefault("table", {})
    for name in sorted(name for name in (*tool, *work) if is_linear(name)):
        reach = axes[name]["range"]
        low, high = (0.0, 0.0) if isinstance(reach, str) else reach
        default = f"{low if name[0] in ('YZ' if lying else 'Z') else 0.5 * (low + high):g}"
        text = Message(
            "{name}: its position with the spindle nose (without tool) at the centre of the table's surface", name=name
        )
        _ask(table, name, text, default, _single, Message("a number, mm"))
    for name in (name for name in (*reversed(tool), *work) if not is_linear(name)):
        line = hints.get(name, "XYZ"["ABC".index(name[0])])
        # A distance has no default, but a table that turns about the vertical usually does so about its centre.
        place = "table 0 0 0" if name in work and name[0] == ("B" if lying else "C") else ""
        _ask_rotary(axes[name], name, line, place, of_tool=name in tool)
    _ask(data, "tool_length", Message("Usual tool length, mm"), "0", _single, Message("a number, mm"))


def _ask_rotary(one: dict[str, Any], name: str, line: str, place: str, *, of_tool: bool) -> None:
    """Ask for direction, sense and place of a rotary axis."""
    from twin.machine.description import DIRECTIONS, PLACES, direction_of, is_near, place_of

    text = Message("{name}: direction of the axis (inclined: 0 1 1, or Y Z 45)", name=name)
    _ask(one, "about", text, line, lambda text: text if is_near(direction_of(text), name) else None, DIRECTIONS)
    what = Message("the tool turns") if of_tool else Message("the table turns left-handed, and so the tool")
    text = Message(
        "{name}: with a positive command {what} right-handed about it (iso), or reversed", name=name, what=what
    )
    _ask(
        one,
        "positive",
        text,
        "iso",
        lambda text: text if text in ("iso", "reversed") else None,
        Message("iso or reversed"),
    )
    where = (
        Message("from the spindle nose")
        if of_tool
        else Message("in machine coordinates or from the centre of the table")
    )
    text = Message(
        "{name}: a point of the axis, mm, {where}: {frame} and x y z",
        name=name,
        where=where,
        frame="nose" if of_tool else "machine/table",
    )
    _ask(one, "at", text, place, lambda text: None if place_of(text) is None else text, PLACES)


def _ask(place: dict[str, Any], key: str, text: str, default: str, parse: Callable[[str], Any], expected: str) -> None:
    """Ask for an answer unless it is given."""
    if key not in place:
        place[key] = _question(text, default, parse, expected)


def _reach(text: str) -> list[float] | None:
    values = _floats(text.replace(",", " ").replace("…", " ").split())
    return values if values is not None and len(values) == 2 and values[0] < values[1] else None


def _turns(text: str) -> Any:
    found = "unlimited" if text == "unlimited" else _reach(text)
    return found if isinstance(found, str) or (found and found[0] <= 0.0 <= found[1]) else None


def _single(text: str) -> float | None:
    values = _floats([text])
    return None if values is None else values[0]


def _floats(words: Sequence[str]) -> list[float] | None:
    try:
        return [float(word) for word in words]
    except ValueError:
        return None


def _assumed(data: Mapping[str, Any], description: Description) -> list[str]:
    """Return what was not answered and therefore assumed."""
    chain = description.answers.names
    lines: list[str] = [
        Message(
            "Assumed: shapes and masses are estimates, not the machine's; clearances computed with them are not "
            "those of the machine."
        )
    ]
    if description.answers.spindle == "horizontal":
        lines.append(
            Message(
                "Horizontal spindle: Y is up, Z along the spindle (ISO 841); instruments are planned where you place them."
            )
        )
    for key, what in (
        ("increment", Message("least increment 0.001")),
        ("positive", Message("positive turning as ISO 841")),
        ("about", Message("direction by its letter")),
    ):
        names = [n for n in chain if key not in data["axes"][n] and (key == "increment" or n[0] in "ABC")]
        if names:
            lines.append(Message("Assumed for {names}: {what}", names=" ".join(names), what=what))
    return lines


# --- twin machine check ------------------------------------------------------------------------------


def _check(
    path: Path,
    control: list[Path],
    positions: Path | None,
    no: list[int],
    tool_length: float | None,
    work_origin: str | None,
    tolerance: float,
    html: Path | None,
    language: Language,
) -> CommandResult:
    """Report the statements on a machine, and its differences from the control."""
    from twin.machine.machine import Machine

    loaded = Machine.load(path)
    found = _Statements(loaded, language)
    report: dict[str, Any] = {**found.to_dict(), "machine": str(path)}
    lines = found.lines()
    met = True
    for number in no:
        if not 1 <= number <= len(found.statements):
            raise InputError("no such statement", expected=f"1 to {len(found.statements)}", value=number, setting="no")
        lines.append(
            Message(
                "No to {number}: this contradicts the answer {contradicted}",
                number=number,
                contradicted=found.statements[number - 1].contradicted,
            )
        )
        met = False
    if control:
        from twin.controls.described import StatedKinematics

        stated = StatedKinematics.load(control)
        rows = stated.differences(loaded)
        lines += ["", Message("Compared with {title} ({path}):", title=stated.title, path=stated.path)]
        for name, angle, away, vector in rows:
            off = " ".join(f"{value:+.4f}" for value in vector + 0.0)
            wrong = max(angle, away) > tolerance
            lines.append(
                Message(
                    "  {name}: direction differs by {angle:.4f}°, place by {away:.4f} mm ({off}){differs}",
                    name=name,
                    angle=angle,
                    away=away,
                    off=off,
                    differs=Message("  DIFFERS") if wrong else "",
                )
            )
            met = met and not wrong
        lines += _unchecked(stated)
        report["control"] = [{"axis": name, "angle_deg": angle, "distance_mm": away} for name, angle, away, _ in rows]
    if positions is not None:
        from twin.machine.statements import compare_positions

        origin = (
            None if work_origin is None else three_numbers("--work-origin", work_origin, work_origin, "x,y,z in mm")
        )
        length = loaded.tool_length_mm if tool_length is None else tool_length
        displayed = compare_positions(positions, loaded, length, origin, tolerance)
        lines += ["", *_position_lines(displayed, positions)]
        worst = displayed.worst
        met = met and max(worst) <= tolerance
        report["positions"] = {"worst_mm": worst[0], "worst_deg": worst[1], "origin_mm": displayed.origin_mm.tolist()}
        report["positions"] |= {"cures": list(displayed.cures)}
    report["met"] = met
    if html is not None:
        write_atomic(html, found.page())
    return CommandResult(joined("\n", [*lines, ""]), lambda: report, met=met)


def _position_lines(displayed: Displayed, path: Path) -> list[str]:
    """Return the comparison with displayed positions in lines."""
    lines: list[str] = [Message("Compared with the positions in {path}, machine minus display:", path=path)]
    for line, off, angle in displayed.rows:
        turned = "" if angle != angle else Message(", axis {angle:.4f}°", angle=angle)
        lines.append(
            Message(
                "  line {line}: {off} mm{turned}",
                line=str(line),
                off=Number(" ".join(f"{v:+.4f}" for v in off)),
                turned=turned,
            )
        )
    origin = " ".join(f"{value:.4f}" for value in displayed.origin_mm)
    if displayed.fitted:
        lines.append(
            Message(
                "  after a constant shift by {origin} mm, which is taken for the zero of the display (--work-origin "
                "fixes it)",
                origin=origin,
            )
        )
    away, angle = displayed.worst
    shown = any(one == one for *_, one in displayed.rows)
    lines.append(
        Message("  largest difference: {away:.4f} mm", away=away)
        + (Number(f", {angle:.4f}°") if shown else Message(", tool axis not given"))
    )
    lines += [Message("  all rows would agree with {cure}", cure=cure) for cure in displayed.cures]
    return lines


def _unchecked(stated: StatedKinematics | None) -> list[str]:
    """Return what could not be checked about a control's data."""
    return (
        []
        if stated is None
        else [Message("Not checked ({title}): {text}", title=stated.title, text=text) for text in stated.unchecked]
    )


class _Statements:
    """The statements on a machine, and their output."""

    def __init__(self, made: Machine, language: Language) -> None:
        from twin.machine.statements import statements

        self.language = language
        self.machine = made
        self.statements: list[AxisStatement] = statements(made)

    def lines(self) -> list[str]:
        """Return the statements in lines."""
        lines = [
            self.machine.brief,
            Message("Check at the machine, with care (yes or no; a no: twin machine check MACHINE --no N):"),
        ]
        return [*lines, *(joined("", [f"{n:3}. ", one.text]) for n, one in enumerate(self.statements, 1))]

    def to_dict(self) -> dict[str, Any]:
        """Return the statements for JSON."""
        keys = ("text", "contradicted")
        return {"schema": SCHEMA, "statements": [{key: getattr(one, key) for key in keys} for one in self.statements]}

    def page(self) -> str:
        """Return an HTML page on which every statement is drawn."""
        from html import escape

        from twin.machine.statements import picture

        items = "".join(
            f"<section>{picture(self.machine, one.command)}<p><b>{n}.</b> {escape(say(one.text))}</p>"
            f"<p>☐ {escape(say('yes'))} &nbsp; ☐ {escape(say('no'))}: <small>"
            f"{escape(say('contradicts {answer}', answer=one.contradicted))}</small></p></section>"
            for n, one in enumerate(self.statements, 1)
        )
        style = "body{font:15px sans-serif;margin:2em}section{display:inline-block;width:300px;vertical-align:top;"
        style += "margin:8px;padding:8px;border:1px solid #ccc}"
        title = escape(self.machine.name)
        lead = (
            say("Table (red mark at the front) and tool before, pale, and after the command. +X right, +Y back, +Z up.")
            if self.machine.upright[2, 2] > 0.5
            else say(
                "Table (red mark at the front) and tool before, pale, and after the command. +X left, +Y up, +Z back."
            )
        )
        return (
            f'<!doctype html><html lang="{self.language.value}"><meta charset="utf-8"><title>{title}</title><style>{style}</style>'
            f"<h1>{title}</h1><p>{lead}</p>{items}</html>\n"
        )
