"""Command ``twin check``."""

from __future__ import annotations

from collections import Counter

from twin._common.bundled import DEFAULT
from twin._common.units import count_with_noun
from twin.cli.shared import options
from twin.cli.shared.command import CommandResult, JsonOption, command
from twin.cli.shared.installation import BAD_INPUT, NOT_ALL_MET

SCHEMA = "twin.checks/1"


@command(
    "twin check cone_frustum.nc --tool-length 120",
    "twin check cone_frustum.nc cone_frustum.cls --machine dmu50 --json checked.json",
    "twin check part.h --offsets preset.pr --tools tool.t --subprograms macros",
)
def check(
    programs: options.ProgramsArgument,
    machine: options.MachineOption = DEFAULT,
    mode: options.ModeOption = options.Mode.axis,
    language: options.LanguageOption = None,
    subprograms: options.SubprogramsOption = None,
    tool_length: options.ToolOption = None,
    work_offset: options.OffsetOption = None,
    work_origin: options.OriginOption = None,
    offsets: options.OffsetsOption = None,
    tools: options.ToolsOption = None,
    json_file: JsonOption = None,
) -> CommandResult:
    """Examine NC programs before anything is computed.

    Language and control, tools, work offsets, planes, travel, time, and what would not be corrected. Nothing is corrected or written.
    One program is described in full, several in one line each. The exit status is the worst of all: 2 if `twin compensate` would
    refuse a program, 3 if it would leave feeds as written or an axis leaves its range, else 0.
    """
    from twin.compensation import Options
    from twin.compensation.programs.check import check_program

    loaded = options.machine(machine)
    settings = Options(
        setup=options.setup(loaded, work_offset, work_origin, offsets, tools),
        tool_length_mm=tool_length,
        tcp=mode is options.Mode.tcp,
        language=language,
        subprograms=tuple(subprograms or ()),
    )
    found = [check_program(program, loaded, options=settings) for program in programs]
    count = Counter(one.verdict for one in found)
    status = BAD_INPUT if count["refused"] else NOT_ALL_MET if count["in part"] else 0
    refused = [f"twin: {one.error}" for one in found if one.error is not None]
    if len(found) == 1:
        text = found[0].to_text()
    else:
        wide = max(len(str(program)) for program in programs)
        lines = [f"{one.program!s:<{wide}}  {one.brief}" for one in found]
        total = f"{count['ready']} ready, {count['in part']} in part, {count['refused']} refused"
        text = "\n".join([*lines, "", f"{count_with_noun(len(found), 'program')}: {total}", ""])
    return CommandResult(
        text,
        lambda: {"schema": SCHEMA, "exit_status": status, "programs": [one.to_dict() for one in found]},
        errors=refused,
        status=status,
    )
