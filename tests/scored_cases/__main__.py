"""Draw cases, run methods on them and score their answers.

    python -m tests.scored_cases -o FOLDER                        all kinds of case on all machines, method `twin`
    python -m tests.scored_cases -o FOLDER --kinds outside --machines dmu50 --draws 25 --workers 2
    python -m tests.scored_cases -o FOLDER --method mine='mine {table} {machine} {json}'

A case is a folder in FOLDER/cases: ``measured.csv``, ``machine.txt`` (the argument of -m) and ``truth.json``. Each answer is saved in
FOLDER/answers at once, so that a second run continues an interrupted one. The table is printed and written to FOLDER/table.txt and
FOLDER/table.md; FOLDER/wrong.txt has one line for every wrong answer.
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

from tests.scored_cases.cases import KINDS, Case, truth_machines, write_case, write_whole
from tests.scored_cases.gain import removed
from tests.scored_cases.methods import BUILT_IN, Command, Method, run_method
from tests.scored_cases.real import HEADER, REAL_SETS, Answer, RealSet, summary
from tests.scored_cases.scores import SCORES, Score, in_words, is_wrong, probabilities, scores
from tests.scored_cases.table import markdown, reliability, rows, text
from twin._common.errors import InputError
from twin.compute.parallel import Workers, map_as_completed


@dataclass(frozen=True)
class Question:
    """One case for one method."""

    method: Method
    case: Case

    @property
    def name(self) -> str:
        return f"{self.method.name} {self.case.name}"

    def answer(self, folder: Path) -> Path:
        """Return the path of its answer."""
        return folder / "answers" / self.method.name / f"{self.case.name}.json"


def ask(folder: Path, question: Question) -> str:
    """Write the case, if new, and the answer to it; return its scores as text."""
    case = write_case(question.case, folder)
    machine = (case / "machine.txt").read_text(encoding="utf-8").strip()
    path = question.answer(folder)
    path.parent.mkdir(parents=True, exist_ok=True)
    found = run_method(question.method, case / "measured.csv", machine)
    if found["calibration"] is not None:
        with tempfile.TemporaryDirectory() as own:
            calibration = Path(own) / "calibration.yaml"
            calibration.write_text(found["calibration"], encoding="utf-8")
            found["removed"] = removed(question.case, case / "measured.csv", machine, calibration)
    write_whole(path, found)
    score = scores(*kept(folder, question))
    return ", ".join(f"{name} {value:.3g}" for name, value in score.items())


def kept(folder: Path, question: Question) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the truth of a case and the saved answer to it."""
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
    """Run every method on every case; return header and rows of the table, and list wrong answers in ``wrong.txt``.

    Args:
        folder: folder of cases and answers.
        methods: methods to run.
        cases: cases to run them on.
        workers: processes or cluster.
        by_family: one row for every family of hidden effects.
        verbose: report every answer on stderr.
    """
    questions = [Question(method, case) for method in methods for case in cases]
    # Two methods may write the same case at the same time: its files do not depend on the writer.
    new = [one for one in questions if not one.answer(folder).exists()]
    for done, (index, said) in enumerate(
        map_as_completed(ask, folder, new, workers, name=lambda one: one.name), start=1
    ):
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


def stated(folder: Path, methods: Sequence[Method], cases: Sequence[Case]) -> dict[str, list[tuple[float, bool]]]:
    """Return by method the probability of each cause of the saved answers, and whether the cause is there."""
    return {
        method.name: [one for case in cases for one in probabilities(*kept(folder, Question(method, case)))]
        for method in methods
    }


@dataclass(frozen=True)
class RealQuestion:
    """One real data set for one method."""

    method: Method
    name: str

    @property
    def of(self) -> RealSet:
        return next(one for one in REAL_SETS if one.name == self.name)

    def folder(self, folder: Path) -> Path:
        """Return the folder of table, machine file and answer."""
        return folder / "answers" / self.method.name / "real" / self.name.replace(",", "").replace(" ", "-")

    def answer(self, folder: Path) -> Path:
        """Return the path of its answer."""
        return self.folder(folder) / "answer.json"


def ask_real(folder: Path, question: RealQuestion) -> None:
    """Write the files of a real data set and the answer to it."""
    own = question.folder(folder)
    own.mkdir(parents=True, exist_ok=True)
    table, machine = question.of.files(own)
    (own / "files.txt").write_text(f"{table}\n{machine}\n", encoding="utf-8")
    found = run_method(question.method, table, str(machine))
    if found["calibration"] is not None:
        (own / "calibration.yaml").write_text(found["calibration"], encoding="utf-8")
    write_whole(own / "answer.json", found)


def real_row(folder: Path, question: RealQuestion) -> list[str]:
    """Return the table row of a saved answer."""
    own = question.folder(folder)
    found = json.loads((own / "answer.json").read_text(encoding="utf-8"))
    table, machine = (Path(line) for line in (own / "files.txt").read_text(encoding="utf-8").splitlines())
    calibration = own / "calibration.yaml"
    answer = Answer(found["diagnosis"], calibration if calibration.exists() else None, table, machine)
    return [question.method.name, *summary(question.of.failed(answer), question.of, answer, found["error"])]


def run_real(
    folder: Path, methods: Sequence[Method], workers: Workers | None = None, *, verbose: bool = False
) -> tuple[list[str], list[list[str]]]:
    """Run every method on every available real data set; return header and rows of the table."""
    questions = [RealQuestion(method, one.name) for method in methods for one in REAL_SETS if one.there()]
    new = [one for one in questions if not one.answer(folder).exists()]
    for done, (index, _) in enumerate(
        map_as_completed(ask_real, folder, new, workers, name=lambda one: one.name), start=1
    ):
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
        prog="python -m tests.scored_cases",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="scores:\n" + "\n".join(f"  {name}: {meaning}" for name, meaning in SCORES.items()),
    )
    parser.add_argument("-o", "--folder", type=Path, required=True, help="folder of cases, answers and table")
    parser.add_argument("--machines", nargs="+", choices=truth_machines(), default=list(truth_machines()))
    parser.add_argument(
        "--kinds",
        nargs="*",
        default=list(KINDS),
        help=f"kinds of case, or prefixes of them; empty for the real data sets only: {', '.join(KINDS)}",
        metavar="KIND",
    )
    parser.add_argument(
        "--real",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="include the real data sets that are available",
    )
    parser.add_argument("--draws", type=int, default=20, help="number of cases of each kind on each machine")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--method",
        type=_method,
        action="append",
        help=f"one of {', '.join(BUILT_IN)}, or NAME='command {{table}} {{machine}} {{json}}'; may be repeated",
    )
    parser.add_argument("--by-family", action="store_true", help="one row for every family of hidden effects")
    parser.add_argument("--only-draw", action="store_true", help="write the cases and run no method")
    parser.add_argument("--workers", type=int, help="number of local processes; default: one per core")
    parser.add_argument("--scheduler", help="address of a Dask scheduler whose workers can import this package")
    found = parser.parse_args()
    unknown = [word for word in found.kinds if not any(kind.startswith(word) for kind in KINDS)]
    if unknown:
        parser.error(f"no kind of case begins with {unknown[0]}; expected one of {', '.join(KINDS)}")
    found.kinds = [kind for kind in KINDS if kind.startswith(tuple(found.kinds))]
    try:
        found.workers = Workers(found.workers, found.scheduler)
    except InputError as error:
        parser.error(str(error))
    return found


def main() -> None:
    """Run the benchmark according to the command line."""
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
        for _ in map_as_completed(write_case_in, folder, cases, options.workers, name=lambda case: case.name):
            pass
        return
    methods = options.method or [BUILT_IN["twin"]]
    tables = [run(folder, methods, cases, options.workers, by_family=options.by_family, verbose=True)]
    tables.append(reliability(stated(folder, methods, cases)))
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
    from tests.scored_cases import __main__ as benchmark  # the name under which workers import it

    benchmark.main()
