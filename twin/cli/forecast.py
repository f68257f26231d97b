"""Command ``twin forecast``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin._common.bundled import DEFAULT
from twin._common.families import Language
from twin.cli.shared import options
from twin.cli.shared.command import EXISTING, HTML, CommandResult, JsonOption, command, progress_bar
from twin.cli.shared.paper import JobOption, LangOption, LogoOption, PdfOption, paper

PageOption = Annotated[Path | None, typer.Option("--output", "-o", help="Write the page to this HTML file."), HTML]
SceneOption = Annotated[
    Path | None,
    typer.Option(
        "--scene", help="Write the machine running the program, features by their probability, to this HTML file."
    ),
    HTML,
]


@command(
    "twin forecast part.nc --features part.yaml --tool-length 120",
    "twin forecast part.nc --features part.yaml --calibration mine.yaml --json forecast.json",
    "twin forecast part.nc --features part.yaml -o forecast.html --scene scene.html --place --lang de",
)
def forecast(
    program: options.ProgramArgument,
    features: Annotated[
        Path, typer.Option("--features", help="Features, tolerances and tools of the part (.yaml)."), EXISTING
    ],
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    mode: options.ModeOption = options.Mode.axis,
    language: options.LanguageOption = None,
    tool_length: options.ToolOption = None,
    work_offset: options.OffsetOption = None,
    work_origin: options.OriginOption = None,
    offsets: options.OffsetsOption = None,
    tools: options.ToolsOption = None,
    temperature: options.TemperatureOption = None,
    time: options.TimeOption = None,
    rpm: options.RpmOption = None,
    load: options.LoadOption = None,
    machines: Annotated[int, typer.Option("--machines", help="Number of machines drawn.", min=100, max=100_000)] = 1000,
    place: Annotated[
        bool,
        typer.Option("--place", help="Search for a better place and orientation of the part in the working volume."),
    ] = False,
    json_file: JsonOption = None,
    output: PageOption = None,
    scene_file: SceneOption = None,
    pdf_file: PdfOption = None,
    job: JobOption = None,
    logo: LogoOption = None,
    lang: LangOption = Language.en,
) -> CommandResult:
    """Forecast which tolerances of a part a program holds on this machine, as it is and compensated.

    The exit status is 3 unless every tolerance is held by one of the two with a probability of at least 95 %.
    """
    from twin._common.bundled import find_program
    from twin.compensation.programs.prepared import Options
    from twin.nc import read_program
    from twin.part.features import PartDrawing
    from twin.part.forecast import forecast as run
    from twin.part.made import with_tools

    page = paper(output, pdf_file, job, logo, lang, drawn=False)
    loaded = options.machine(machine)
    errors = options.calibration_of(calibration, loaded)
    part, source = PartDrawing(features), find_program(program)
    used = Options(
        setup=options.setup(loaded, work_offset, work_origin, offsets, tools),
        tool_length_mm=tool_length,
        tcp=mode is options.Mode.tcp,
        conditions=options.conditions(temperature, time, rpm, load),
    )
    with progress_bar() as bar:
        found = run(
            part, read_program(program, language), loaded, errors, used, machines=machines, place=place, progress=bar
        )
    drawn = None
    if scene_file is not None:
        from twin.reporting.scene.draw import draw_program  # imports meshcat, which is slow and needed only here

        drawn = draw_program(
            source,
            loaded,
            errors,
            tool_length_mm=tool_length,
            tcp=used.tcp,
            setup=with_tools(part, used.setup),
            conditions=used.conditions,
            language=language,
            features=found.in_work_frame(),
        )
    page.write(found.to_html, [source, features, *([] if calibration is None else [calibration])])
    if scene_file is not None and drawn is not None:
        drawn.save(scene_file)
    return CommandResult(found.to_text(), found.to_dict, met=found.met)
