"""Draw cases, ask methods, score their answers.

    python -m tests.benchmark -o FOLDER                        all kinds of case on all machines, asked of `twin`
    python -m tests.benchmark -o FOLDER --kinds outside --machines dmu50 --draws 25 --workers 2
    python -m tests.benchmark -o FOLDER --method mine='mine {table} {machine} {json}'

A case is a folder in FOLDER/cases: ``measured.csv``, ``machine.txt`` (what goes after -m) and ``truth.json``. Each answer is kept in
FOLDER/answers as it comes, so that a second run goes on where the first one stopped. The table is printed and written to
FOLDER/table.txt and FOLDER/table.md; FOLDER/wrong.txt has a line for every answer that is wrong.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.benchmark.cases import KINDS, Case, truth_machines, write_case, write_whole
from tests.benchmark.gain import removed
from tests.benchmark.methods import BUILT_IN, Command, Method, asked
from tests.benchmark.real import HEADER, REAL_SETS, Answer, RealSet, summary
from tests.benchmark.scores import SCORES, Score, in_words, is_wrong, scores
from tests.benchmark.table import markdown, rows, text
from twin._common.errors import InputError
from twin.compute.parallel import Workers, finished


@dataclass(frozen=True)
class Question:
    """One case asked of one method."""

    method: Method
    case: Case

    @property
    def name(self) -> str:
        return f"{self.method.name} {self.case.name}"

    def answer(self, folder: Path) -> Path:
        """Where its answer is kept."""
        return folder / "answers" / self.method.name / f"{self.case.name}.json"


def ask(folder: Path, question: Question) -> str:
    """Write the case unless it is there, and the answer to it; return what it scores, in words."""
    case = write_case(question.case, folder)
    machine = (case / "machine.txt").read_text(encoding="utf-8").strip()
    path = question.answer(folder)
    path.parent.mkdir(parents=True, exist_ok=True)
    found = asked(question.method, case / "measured.csv", machine)
    if found["calibration"] is not None:
        with tempfile.TemporaryDirectory() as own:
            calibration = Path(own) / "calibration.yaml"
            calibration.write_text(found["calibration"], encoding="utf-8")
            found["removed"] = removed(question.case, case / "measured.csv", machine, calibration)
    write_whole(path, found)
    score = scores(*kept(folder, question))
    return ", ".join(f"{name} {value:.3g}" for name, value in score.items())


def kept(folder: Path, question: Question) -> tuple[dict[str, Any], dict[str, Any]]:
    """What is hidden in a case, and the answer to it."""
    truth = folder / "cases" / question.case.name / "truth.json"
    hidden, answer = (json.loads(path.read_text(encoding="utf-8")) for path in (truth, question.answer(folder)))
    return hidden, answer


def run(
    folder: Path,
    methods: Sequence[Method],
    cases: Sequence[Case],
    workers: Workers | None = None,
    *,
    by_family: bool = False,
    verbose: bool = False,
) -> tuple[list[str], list[list[str]]]:
    """Ask every method every case; header and rows of the table. What is wrong is listed in ``wrong.txt`` of the folder.

    Args:
        folder: of cases and answers.
        methods: whom to ask.
        cases: what to ask.
        workers: who does it.
        by_family: a row for every family of effects that is hidden.
        verbose: report every answer on stderr.
    """
    questions = [Question(method, case) for method in methods for case in cases]
    # Two methods may meet at a case that is not written yet: files of a case are the same whoever writes them.
    new = [one for one in questions if not one.answer(folder).exists()]
    for done, (index, said) in enumerate(finished(ask, folder, new, workers, name=lambda one: one.name), start=1):
        if verbose:
            sys.stderr.write(f"{done} of {len(new)}: {new[index].name}: {said}\n")
    answers: list[tuple[str, str, str, Score]] = []
    wrong = []
    for one in questions:
        hidden, answer = kept(folder, one)
        score = scores(hidden, answer)
        effects = " and ".join(each["effect"] for each in hidden["effects"]) if by_family else ""
        answers.append((one.method.name, one.case.machine, f"{one.case.kind} {effects}".strip(), score))
        if is_wrong(score):
            wrong.append(f"{one.name}: {in_words(hidden, answer)}\n")
    (folder / "wrong.txt").write_text("".join(wrong), encoding="utf-8")
    return rows(answers)


@dataclass(frozen=True)
class RealQuestion:
    """One real set asked of one method."""

    method: Method
    name: str

    @property
    def of(self) -> RealSet:
        return next(one for one in REAL_SETS if one.name == self.name)

    def folder(self, folder: Path) -> Path:
        """Of table, machine file and answer."""
        return folder / "answers" / self.method.name / "real" / self.name.replace(",", "").replace(" ", "-")

    def answer(self, folder: Path) -> Path:
        """Where its answer is kept."""
        return self.folder(folder) / "answer.json"


def ask_real(folder: Path, question: RealQuestion) -> None:
    """Write the files of a real set and the answer to it."""
    own = question.folder(folder)
    own.mkdir(parents=True, exist_ok=True)
    table, machine = question.of.files(own)
    (own / "files.txt").write_text(f"{table}\n{machine}\n", encoding="utf-8")
    found = asked(question.method, table, str(machine))
    if found["calibration"] is not None:
        (own / "calibration.yaml").write_text(found["calibration"], encoding="utf-8")
    write_whole(own / "answer.json", found)


def real_row(folder: Path, question: RealQuestion) -> list[str]:
    """The row of an answer that is kept."""
    own = question.folder(folder)
    found = json.loads((own / "answer.json").read_text(encoding="utf-8"))
    table, machine = (Path(line) for line in (own / "files.txt").read_text(encoding="utf-8").splitlines())
    calibration = own / "calibration.yaml"
    answer = Answer(found["diagnosis"], calibration if calibration.exists() else None, table, machine)
    return [question.method.name, *summary(question.of.failed(answer), question.of, answer, found["error"])]


def run_real(
    folder: Path, methods: Sequence[Method], workers: Workers | None = None, *, verbose: bool = False
) -> tuple[list[str], list[list[str]]]:
    """Ask every method every real set whose files are there; header and rows of the table."""
    questions = [RealQuestion(method, one.name) for method in methods for one in REAL_SETS if one.there()]
    new = [one for one in questions if not one.answer(folder).exists()]
    for done, (index, _) in enumerate(finished(ask_real, folder, new, workers, name=lambda one: one.name), start=1):
        if verbose:
            sys.stderr.write(f"{done} of {len(new)} real: {new[index].method.name} {new[index].name}\n")
    return ["method", *HEADER], [real_row(folder, one) for one in questions]


def _method(word: str) -> Method:
    name, separator, command = word.partition("=")
    if not separator:
        if name not in BUILT_IN:
            raise argparse.ArgumentTypeError(f"{name} is not one of {', '.join(BUILT_IN)}; or give NAME=COMMAND")
        return BUILT_IN[name]
    return Command(name, command)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmark",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="scores:\n" + "\n".join(f"  {name}: {meaning}" for name, meaning in SCORES.items()),
    )
    parser.add_argument("-o", "--folder", type=Path, required=True, help="of cases, answers and table")
    parser.add_argument("--machines", nargs="+", choices=truth_machines(), default=list(truth_machines()))
    parser.add_argument(
        "--kinds",
        nargs="*",
        default=list(KINDS),
        help=f"or how they begin; none for the real sets alone: {', '.join(KINDS)}",
        metavar="KIND",
    )
    parser.add_argument(
        "--real", action=argparse.BooleanOptionalAction, default=True, help="the real sets too, where they are"
    )
    parser.add_argument("--draws", type=int, default=20, help="cases of each kind on each machine")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--method",
        type=_method,
        action="append",
        help=f"one of {', '.join(BUILT_IN)}, or NAME='command {{table}} {{machine}} {{json}}'; may be repeated",
    )
    parser.add_argument("--by-family", action="store_true", help="a row for every family of effects that is hidden")
    parser.add_argument("--only-draw", action="store_true", help="write the cases, ask nothing")
    parser.add_argument("--workers", type=int, help="processes of this computer: one a core if not given")
    parser.add_argument("--scheduler", help="address of a Dask scheduler, whose workers have this folder on their path")
    found = parser.parse_args()
    unknown = [word for word in found.kinds if not any(kind.startswith(word) for kind in KINDS)]
    if unknown:
        parser.error(f"no kind of case begins with {unknown[0]}; there are {', '.join(KINDS)}")
    found.kinds = [kind for kind in KINDS if kind.startswith(tuple(found.kinds))]
    try:
        found.workers = Workers(found.workers, found.scheduler)
    except InputError as error:
        parser.error(str(error))
    return found


def main() -> None:
    """Do what the command line asks for."""
    options = _arguments()
    folder = options.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    cases = [
        Case(machine, kind, number, options.seed)
        for machine in options.machines
        for kind in options.kinds
        for number in range(options.first, options.first + options.draws)
    ]
    if options.only_draw:
        for _ in finished(write_case_in, folder, cases, options.workers, name=lambda case: case.name):
            pass
        return
    methods = options.method or [BUILT_IN["twin"]]
    tables = [run(folder, methods, cases, options.workers, by_family=options.by_family, verbose=True)]
    if options.real:
        tables.append(run_real(folder, methods, options.workers, verbose=True))
    shown = [table for table in tables if table[1]]
    (folder / "table.txt").write_text("\n".join(text(*table) for table in shown), encoding="utf-8")
    (folder / "table.md").write_text("\n".join(markdown(*table) for table in shown), encoding="utf-8")
    sys.stdout.write("\n".join(text(*table) for table in shown))


def write_case_in(folder: Path, case: Case) -> str:
    """Write a case and return its name."""
    return write_case(case, folder).name


if __name__ == "__main__":
    from tests.benchmark import __main__ as benchmark  # workers know it by this name

    benchmark.main()
