"""Options of the drift tests of ``twin plan``, and the plan that they ask for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, final

import typer

from twin._common.errors import InputError
from twin._common.families import DRIFT_INSTRUMENTS, DRIFTS
from twin.cli.shared import complete
from twin.cli.shared.command import POSITIVE, CommandResult
from twin.cli.shared.terminal import three_numbers

if TYPE_CHECKING:
    from twin.machine.machine import Machine
    from twin.planning import InstrumentSizes, Kit

DriftOption = Annotated[
    str | None,
    typer.Option(
        "--drift",
        help="Plan a thermal test (ISO 230-3): {drifts}; --instrument: {drift_instruments}.",
        autocompletion=complete.drifts,
    ),
]
HighestOption = Annotated[
    float | None,
    typer.Option("--highest-rpm", help="Highest spindle speed, 1/min, with --drift spindle."),
    POSITIVE,
]
SpectrumOption = Annotated[
    bool,
    typer.Option("--spectrum", help="Change the speed at random every 10 min, with --drift spindle; default: steps."),
]
AxisOption = Annotated[
    str | None, typer.Option("--axis", help="Linear or rotary axis that moves, with --drift axes; default: the first.")
]


@final
@dataclass(frozen=True)
class DriftRequest:
    """Options of a drift test: name, highest speed, spectrum, axis, feed, seed, program."""

    name: str | None
    highest_rpm: float | None
    spectrum: bool
    axis: str | None
    feed_mm_min: float | None
    seed: int
    program: Path | None = None

    def wanted(self, others: bool) -> bool:
        """Return whether a drift test is wanted; `InputError` for its options without its name, or beside those of another plan."""
        names = "|".join(DRIFTS)
        if self.name is None and (self.highest_rpm is not None or self.spectrum or self.axis is not None):
            raise InputError("--highest-rpm, --spectrum and --axis need --drift", expected=f"--drift {names}")
        if self.name is not None and others:
            raise InputError("--drift plans a thermal test", expected="no option of another plan", value=self.name)
        return self.name is not None

    def planned(
        self,
        machine: Machine,
        kit: Kit,
        instrument: str | None,
        spheres: list[str] | None,
        minutes: float | None,
        sizes: InstrumentSizes,
        output: Path | None,
    ) -> CommandResult:
        """Plan the drift test and write it."""
        from twin.planning.drift import drift_plan
        from twin.planning.programs import drift_steps, format_of, write_program

        chosen = instrument or DRIFT_INSTRUMENTS[0]
        part = "sphere" if chosen == DRIFT_INSTRUMENTS[0] else "nest"
        places = {
            f"{part} {k + 1}": three_numbers("--spheres", text, text, "x,y,z in mm")
            for k, text in enumerate(spheres or [])
        }
        options = {name: getattr(self, name) for name in ("highest_rpm", "spectrum", "axis", "feed_mm_min", "seed")}
        made = drift_plan(
            machine,
            str(self.name),
            chosen,
            kit,
            places_mm=places or None,
            minutes=minutes,
            sizes=sizes,
            options=options,
        )
        text, report = made.to_text(), made.to_dict()
        if self.program is not None:
            language = format_of(self.program)
            steps = drift_steps(made)
            write_program(steps, self.program)
            report["program"] = {"file": str(self.program), "control": language.title}
            text += f"note: program for {language.title}, NOT RUN ON A MACHINE. {language.unverified if steps.probing else ''}\n"
        if output is not None:
            made.save(output)
        return CommandResult(text, lambda: report)
