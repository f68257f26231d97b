"""Functions that mkdocs calls while it builds the site: pages made from the package itself, so that nothing is written twice.

Generated: the manual and the reference of files from the pages of `twin doc`, the commands from their `--help`, the API from
`twin.__all__`, the course from the notebooks (executed here), and the package diagram from the layers in pyproject.toml. Formulas
are typeset to MathML here, so that a page needs neither a script nor a network.
"""

from __future__ import annotations

import inspect
import re
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from html import escape, unescape
from io import BytesIO
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import latex2mathml.converter
import nbformat
import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from mkdocs.structure.files import File, Files
from nbclient import NotebookClient
from nbconvert import MarkdownExporter

import twin
from twin._common.arrays import read_only
from twin.cli.commands import COMMANDS, load
from twin.cli.doc import PAGES, page_text
from twin.diagnosis.candidates import SPECIFICATIONS
from twin.diagnosis.forms import LEAST_NONCENTRALITY, columns_of
from twin.diagnosis.readings import readings
from twin.diagnosis.search import candidates_of
from twin.diagnosis.second_opinion import Key
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Axis
from twin.measurement.instruments import INSTRUMENTS, Instrument
from twin.model.effects import Effect, Specification
from twin.model.effects.base import axis_of
from twin.numerics.curves import BASES

ROOT = Path(__file__).resolve().parent.parent
PICTURES = ROOT / ".pictures"
BOX_WIDTH, BOX_HEIGHT, GAP = 150, 34, 16
POINTS = 400  # of a curve in a picture
DISTANCES_MM = (100.0, 1000.0, 3000.0, 10_000.0)  # at which the uncertainty of an instrument is given
KNOTS = (0.0, 90.0, 180.0, 270.0, 360.0)  # of the spline in the picture of the bases
BASES_PICTURE = "\n![The first functions of each basis over a turn](curves.svg)\n"
READING_SECTIONS = (
    "`E_aa` is the error motion of an axis along its own motion. Pictures show the example below them, alone. *Most alike* is"
    " the cause of another kind that changes the readings of the thesis's plan most nearly in the same way (temperatures and"
    " speeds change, the set-up is fitted): the cosine of the angle between the two, of forms with at most two parameters. At"
    " 1.00 these readings cannot distinguish them, or one contains the other; another plan has other values."
)
# Parameters of the examples of effects, in the units of their specifications.
EXAMPLE = {
    **{
        "size": 5.0,
        "offset": -7.0,
        "amplitude": 6.0,
        "period": 20.0,
        "phase": 0.4,
        "coefficient": 4.0,
        "time_constant": 1200.0,
    },
    **{
        "place": 210.0,
        "width": 20.0,
        "tilt": 12.0,
        "moment": 40.0,
        "order": 3.0,
        "cos": 6.0,
        "sin": -4.0,
        "compliance": 2.0,
    },
    **{"exponent": 1.3, "highest_rpm": 12000.0, "c0": 5.0, "c1": -3.0},
}


def on_files(files: Files, config: Any) -> Files:
    """Add every generated page and picture."""
    for path, content in generated():
        files.append(File.generated(config, path, content=content))
    return files


def on_page_content(html: str, page: Any, config: Any, files: Files) -> str:
    """Typeset the formulas of a page, which `pymdownx.arithmatex` marks; raise an exception for one that is not understood."""
    return re.sub(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', formula, html, flags=re.S)


def formula(found: re.Match[str]) -> str:
    """Return a formula in MathML."""
    kind, text = found.groups()
    display = "block" if kind == "div" else "inline"
    return f'<{kind} class="formula">{latex2mathml.converter.convert(unescape(text), display=display)}</{kind}>'


def generated() -> Iterator[tuple[str, str | bytes]]:
    """Yield the path and the content of every generated file."""
    further = {"effects": effect_sections(), "instruments": instrument_sections(), "curves": BASES_PICTURE}
    for name in PAGES:
        path = "reference/files.md" if name == "files" else f"manual/{name}.md"
        yield path, manual_page(name) + further.get(name, "")
    yield from pictures_of_families()
    yield "reference/api.md", api_page()
    yield "reference/commands.md", commands_page()
    yield "development/packages.svg", package_diagram()
    for picture in sorted(PICTURES.glob("*.png")):
        yield f"pictures/{picture.name}", picture.read_bytes()
    with ThreadPoolExecutor(2) as pool:  # each executes in a process of its own
        for pages in pool.map(course_pages, sorted((ROOT / "notebooks").glob("*.ipynb"))):
            yield from pages


def manual_page(name: str) -> str:
    """Return a page of `twin doc` with a title."""
    return f"# {name.capitalize()}\n\n{page_text(name)}\n*In a terminal: `twin doc {name}`.*\n"


def effect_sections() -> str:
    """Return a section for each cause that a diagnosis knows, from its specification."""
    machine = twin.Machine.load("dmu50")
    parts, alike = [f"\n{READING_SECTIONS}"], neighbours(machine)
    kinds = {
        "machine": "Errors of the machine",
        "instrument": "Errors of the instrument",
        "calibration": "Mistakes in the calibration",
    }
    for kind, title in kinds.items():
        parts.append(f"\n## {title}\n")
        for one in SPECIFICATIONS.values():
            if one.kind == kind:
                parts += [f"### `{one.name}`: {one.plural}\n", *effect_section(one, machine, alike.get(one.name))]
    return "\n".join(parts)


def neighbours(machine: twin.Machine) -> dict[str, tuple[float, Key, Key]]:
    """Return of each effect the likeness to the most similar cause of another one, and both, in readings of the thesis's plan."""
    plan, tracker = twin.thesis_plan.plan(machine), twin.instruments.LaserTracker()
    hours = plan.time_s / 3600.0
    warm = {
        name: read_only(20.0 + 4.0 * np.sin(rate * hours))
        for name, rate in (("X", 1.1), ("Y", 1.7), ("Z", 2.3), ("bed", 0.4))
    }
    speed = read_only(np.where(np.sin(2.0 * hours) > 0.0, 12000.0, 0.0))
    given = replace(plan, temperature_degC=warm, channels={"spindle_rpm": speed})
    zero = twin.Calibration.zero(machine)
    data, _ = twin.simulate(given, machine, zero, tracker, np.random.default_rng(1))
    placed = readings(data, machine, zero, tracker)
    candidates = candidates_of(placed.without(placed.bad))
    few = [form for form in candidates.forms if len(form.columns) <= 2]
    columns = columns_of(few)
    gram = candidates.cross(columns)[:, columns]
    at = [np.searchsorted(columns, form.columns) for form in few]
    seen = [bool(np.linalg.eigvalsh(gram[np.ix_(own, own)])[0] > LEAST_NONCENTRALITY) for own in at]
    roots = [
        np.linalg.inv(np.linalg.cholesky(gram[np.ix_(own, own)])) if ok else None
        for own, ok in zip(at, seen, strict=True)
    ]
    found: dict[str, tuple[float, Key, Key]] = {}
    for i, j in combinations(np.flatnonzero(seen).tolist(), 2):
        (first, a), (second, b) = (few[i].key, at[i]), (few[j].key, at[j])
        if first[0] != second[0]:
            # Cosine of the smallest angle between the spaces of the two (canonical correlation).
            cosine = float(np.linalg.norm(roots[i] @ gram[np.ix_(a, b)] @ roots[j].T, 2))
            for own, other in ((first, second), (second, first)):
                if cosine > found.get(own[0], (0.0,))[0]:
                    found[own[0]] = (cosine, own, other)
    return found


def effect_section(one: Specification, machine: twin.Machine, alike: tuple[float, Key, Key] | None) -> Iterator[str]:
    """Yield formula, picture, what separates a cause from others, advice, and an example."""
    places, made = one.places(machine), example(one, machine)
    if made is not None:
        yield f"{described(made)}\n\n![{one.plural}](effects/{one.name}.svg)\n"
    if places:
        needs = ", ".join(f"`{name}`" for name in one.channels(example_place(one, machine)))
        yield f"- **Where:** `{places[0]}` … `{places[-1]}` ({len(places)} on the {machine.name})." + (
            f" **Needs** {needs} in the table." if needs else ""
        )
    yield f"- **Separated from others:** {' '.join(separated(one, machine))}"
    if alike is not None:
        likeness, own, other = alike
        yield f"- **Most alike:** `{' '.join(own)}` and `{' '.join(other).removesuffix(' —')}`, {likeness:.2f}."
    at = example_place(one, machine) if places else ""
    look = one.advice.look.replace("{axis}", axis_of(at) if at else "the axis").replace("{where}", at or "its place")
    yield f"- **Where to look:** {look}"
    if one.make is None and made is not None:
        yield "- **In a calibration:** one of its own curves, squareness errors or locations; in the picture, the illustrative one."
    elif made is not None:
        numbers = ", ".join(f"{name}: {value:g}" for name, value in numbers_of(one).items())
        entry = f"{{effect: {one.name}, where: {example_place(one, machine)}, parameters: {{{numbers}}}}}"
        yield f"- **In a calibration** (as in the picture): `{entry}`"
    yield ""


def described(one: Effect | Instrument) -> str:
    """Return what a class says of itself, without its attributes."""
    paragraphs = (inspect.getdoc(type(one)) or "").split("\n\nAttributes:")[0].split("\n\nArgs:")[0].split("\n\n")
    return "\n\n".join(text for text in paragraphs if "see `Instrument`" not in text)


def separated(one: Specification, machine: twin.Machine) -> Iterator[str]:
    """Yield what readings must contain so that a cause is not taken for another, in sentences."""
    yield {
        "never": "It is the same in every round.",
        "with time": "It changes between rounds: repeat points over the time or temperature range.",
        "with the frame": "It turns with the instrument's frame.",
    }[one.varies]
    split = one.drawing.split(example_place(one, machine)) if one.places(machine) else ""
    if split.startswith("approach"):
        yield "Approach the same positions from both sides."
    elif split:
        yield "Measure it at several positions of the axis."
    if one.curve:
        yield "A curve: it must predict positions that were held out."
    if one.variant_of:
        yield f"It is a variant of `{one.variant_of}` with more parameters, and must predict held-out readings better."
    if one.all_or_nothing:
        yield "It is there completely or not at all: a part of it is refused."
    if one.kind != "machine":
        yield f"To decide: {one.decided_by}."


def example_place(one: Specification, machine: twin.Machine) -> str:
    """Return the first place of an effect that needs no load, with a sensor where one is part of the place."""
    where = next(place for place in one.places(machine) if not place.endswith(" by load"))
    return f"{where} bed" if where.endswith(" by") else where


def numbers_of(one: Specification) -> dict[str, float]:
    """Return parameters of an example: some micrometres, microradians, and hours."""
    return {name: EXAMPLE[name] for name in one.parameters}


def example(one: Specification, machine: twin.Machine) -> Effect | None:
    """Return an example of an effect: of an entry, else that of the illustrative calibration; None for what is in no calibration."""
    if one.make is None:
        known = {effect.name: effect for effect in twin.Calibration.default(machine).effects}
        return next((known[place] for place in one.places(machine) if place in known), None)
    return twin.effect_named(one.name, example_place(one, machine), numbers_of(one), machine)


def pictures_of_families() -> Iterator[tuple[str, bytes]]:
    """Yield a picture of each effect over its variable, and of the functions of each basis."""
    machine = twin.Machine.load("dmu50")
    for one in SPECIFICATIONS.values():
        effect = example(one, machine)
        if effect is not None:
            yield f"manual/effects/{one.name}.svg", effect_picture(one, effect, machine)
    figure = Figure(figsize=(7.0, 1.8 * len(BASES)), layout="constrained")
    for axes, basis in zip(figure.subplots(len(BASES), 1), BASES, strict=True):
        made = basis(KNOTS) if basis.name == "cubic_spline" else basis()
        q = np.linspace(0.0, 360.0, 400)
        for values in made.functions(q, (0.0, 360.0), 7):
            axes.plot(q, np.broadcast_to(values, q.shape))
        axes.set_title(basis.name, fontsize=9)
    yield "manual/curves.svg", svg(figure)


def effect_picture(one: Specification, effect: Effect, machine: twin.Machine) -> bytes:
    """Return the components of an effect over what it depends on; dashed: from the other side, or at the ends of another axis."""
    place = example_place(one, machine) if one.make is not None else effect.name
    state = {axis.name: np.full(POINTS, 0.5 * sum(limits_of(axis))) for axis in machine.axes}
    state |= {f"approach_{name}": np.ones(POINTS) for name in machine.names}
    hours = np.linspace(0.0, 2.0, POINTS)
    variable, label = variable_of(one, place, machine)
    warm = np.where(hours > 0.25, 25.0, 20.0) if variable == "time_s" else np.linspace(15.0, 30.0, POINTS)
    state |= {f"T_{name}_degC": warm for name in (*machine.names, "bed")}
    state |= {"time_s": 3600.0 * hours, "spindle_rpm": np.where((hours > 0.25) & (hours < 1.25), 12000.0, 0.0)}
    if variable in machine.by_name:
        state[variable] = np.linspace(*limits_of(machine.by_name[variable]), POINTS)
    x = hours if variable == "time_s" else state[variable]
    figure = Figure(figsize=(6.0, 2.2), layout="constrained")
    axes, split = figure.subplots(), one.drawing.split(place)
    sides = (1.0, -1.0) if split.startswith("approach") else limits_of(machine.by_name[split]) if split else (None,)
    for side, line in zip(sides, ("-", "--"), strict=False):
        there = state if side is None else state | {split: np.full(POINTS, side)}
        for component, values in effect.components(there).items():
            name = f"{DIRECTIONS[component]}, {'µm' if component < 3 else 'µrad'}"
            known = f"{name}" if side is None else f"{name} ({split.replace('approach_', 'approach ')} {side:+g})"
            axes.plot(x, np.broadcast_to(np.asarray(values, dtype=float), x.shape), line, label=known)
    axes.set_xlabel(label)
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return svg(figure)


def variable_of(one: Specification, place: str, machine: twin.Machine) -> tuple[str, str]:
    """Return what an effect is drawn over, and its label: time if it needs it, else a temperature, else an axis."""
    columns = one.drawing.columns(place) if one.drawing.columns else ()
    needed = (*one.channels(place), *columns)
    if "time_s" in needed:
        return "time_s", "time, h (from 0.25 h on warm, or the spindle turning)"
    sensor = next((name for name in needed if name.startswith("T_")), "")
    if sensor:
        return sensor, f"{sensor.removesuffix('_degC').removeprefix('T_')} temperature, °C"
    axis = machine.by_name[next((name for name in columns if name in machine.by_name), axis_of(place))]
    return axis.name, f"{axis.name}, {axis.unit}"


def limits_of(axis: Axis) -> tuple[float, float]:
    """Return the range of an axis; one turn if it has none."""
    return (0.0, 360.0) if axis.lower is None or axis.upper is None else (axis.lower, axis.upper)


def svg(figure: Figure) -> bytes:
    """Return a figure as SVG, the same for the same figure."""
    content = BytesIO()
    with rc_context({"svg.hashsalt": "twin"}):
        figure.savefig(content, format="svg", metadata={"Date": None})
    return content.getvalue()


def instrument_sections() -> str:
    """Return a section for each instrument: what it reads, its default uncertainty at distances, and its own errors."""
    parts = []
    for one in INSTRUMENTS:
        known = one.specification
        parts.append(f"\n## `{known.name}`: {known.title}\n\n{described(one)}\n")
        own = ", ".join(f"[`{name}`](effects.md)" for name in known.effects) or "none"
        parts.append(f"Its own errors that a diagnosis looks for: {own}.\n")
        distances = [mm for mm in DISTANCES_MM if mm <= known.range_mm and known.reads != "null"] or [0.0]
        points = np.array([[1e-3 * mm, 0.0, 0.0] for mm in distances]).reshape(-1, 3)
        sizes = 1e6 * np.sqrt(np.einsum("nii->ni", one.covariance(points)))
        rows = [
            f"| {mm:g} | {' | '.join(f'{u:.2g}' for u in own[: len(known.columns) or 3])} |"
            for mm, own in zip(distances, sizes.tolist(), strict=True)
        ]
        names = known.columns or ("x", "y", "z")
        head = " | ".join(f"u of {name.removesuffix('_mm')}, µm" for name in names)
        parts += [f"| target along x at, mm | {head} |", "|---" * (len(names) + 1) + "|", *rows, ""]
    return "\n".join(parts)


def api_page() -> str:
    """Return the reference of every name that `import twin` gives: classes, functions, modules."""
    values = {name: getattr(twin, name) for name in twin.__all__ if not name.startswith("_")}
    groups = {"Classes": inspect.isclass, "Functions": inspect.isfunction, "Modules": inspect.ismodule}
    parts = [
        "# API\n\n`import twin` gives every name on this page; each is imported when it is first used. Arrays are (n, axes) in"
        " command order, in mm and degrees, and read-only in results. The examples begin with `import numpy as np` and `import twin`.\n"
    ]
    for title, belongs in groups.items():
        parts.append(f"## {title}\n")
        for name, value in values.items():
            if belongs(value):
                path = value.__name__ if inspect.ismodule(value) else f"{value.__module__}.{value.__qualname__}"
                parts.append(
                    f"### twin.{name}\n\n::: {path}\n    options: {{show_root_heading: false, heading_level: 4}}\n"
                )
    return "\n".join(parts)


def commands_page() -> str:
    """Return the reference of all commands: arguments and options with their help, and examples."""
    parts = ["# Commands\n\nExit status: 0 done; 2 bad input; 3 done, but something that matters was not met.\n"]
    for name, summary in COMMANDS.items():
        command = load(name)
        parts.append(f"## twin {name}\n\n{summary}\n\n{command.help or ''}\n")
        rows = [
            f"| `{' '.join(one.opts) or one.name}` | {cell(getattr(one, 'help', None))} | {default(one)} |"
            for one in command.params
        ]
        parts.append("\n".join(["| option or argument | meaning | default |", "|---|---|---|", *rows, ""]))
        examples = [line.strip() for line in (command.epilog or "").splitlines() if line.strip().startswith("twin ")]
        parts.append("\n".join(["```sh", *examples, "```", ""]) if examples else "")
    return "\n".join(parts)


def cell(text: str | None) -> str:
    """Return a text that fits a cell of a table."""
    return escape(text or "", quote=False).replace("|", "\\|").replace("\n", " ")


def default(parameter: Any) -> str:
    """Return a parameter's default as text."""
    value = parameter.default
    if parameter.required or value is None or callable(value) or value == ():
        return "required" if parameter.required else ""
    return cell(f"{getattr(value, 'value', value)}")


def package_diagram() -> str:
    """Return the packages by import level as SVG, from the layers contract in pyproject.toml."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    levels = [
        level.split(" | ") for level in next(one for one in contracts if one.get("containers") == ["twin"])["layers"]
    ]
    width = max(map(len, levels)) * (BOX_WIDTH + GAP) + GAP
    height = len(levels) * (BOX_HEIGHT + GAP) + GAP
    shapes = []
    for row, names in enumerate(levels):
        left = (width - len(names) * (BOX_WIDTH + GAP) + GAP) / 2
        for column, name in enumerate(names):
            x, y = left + column * (BOX_WIDTH + GAP), GAP + row * (BOX_HEIGHT + GAP)
            shapes.append(
                f'<rect x="{x:g}" y="{y}" width="{BOX_WIDTH}" height="{BOX_HEIGHT}" rx="5" fill="#eceff1" stroke="#546e7a"/>'
            )
            shapes.append(f'<text x="{x + BOX_WIDTH / 2:g}" y="{y + 22}" text-anchor="middle">{name}</text>')
    style = "font-family: sans-serif; font-size: 14px; fill: #263238"
    size = f'viewBox="0 0 {width} {height}" width="{width}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} style="{style}">{"".join(shapes)}</svg>'


def course_pages(path: Path) -> list[tuple[str, str | bytes]]:
    """Execute a notebook in an empty folder; return its page and its pictures."""
    notebook = nbformat.read(path, as_version=4)
    with TemporaryDirectory() as folder:
        NotebookClient(notebook, timeout=600, resources={"metadata": {"path": folder}}).execute()
    text, resources = MarkdownExporter().from_notebook_node(notebook, {"output_files_dir": path.stem})
    text = re.sub(r"\]\((\w+)\.ipynb\b", r"](\1.md", text)
    pictures = [(f"course/{name}", content) for name, content in resources.get("outputs", {}).items()]
    return [(f"course/{path.stem}.md", without_blank_lines_in_html(text)), *pictures]


def without_blank_lines_in_html(text: str) -> str:
    """Return Markdown whose HTML outputs are one block each: a blank line would end the block."""

    def joined(match: re.Match[str]) -> str:
        return re.sub(r"\n\s*", "\n", match.group())

    return re.sub(r"^<(div|style|table|svg)\b.*?^</\1>", joined, text, flags=re.M | re.S)
