"""Draw cases, ask methods, score their answers.

    python -m tests.benchmark -o FOLDER                        all kinds of case on all machines, asked of `twin`
    python -m tests.benchmark -o FOLDER --kinds outside --machines dmu50 --draws 25 --workers 2
    python -m tests.benchmark -o FOLDER --method mine='mine {table} {machine} {json}'

A case is a folder in FOLDER/cases: ``measured.csv``, ``machine.txt`` (what goes after -m) and ``truth.json``. Each answer is kept in
FOLDER/answers as it comes, so that a second run goes on where the first one stopped. The table is printed and written to
FOLDER/table.txt and FOLDER/table.md.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.benchmark.cases import KINDS, Case, truth_machines, write_case, write_whole
from tests.benchmark.methods import BUILT_IN, Command, Method, asked
from tests.benchmark.scores import SCORES, Score, scores
from tests.benchmark.table import markdown, rows, text
from twin.errors import InputError
from twin.parallel import Workers, finished


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
    """Write the case and the answer to it unless they are there; return what it scores, in words."""
    case = write_case(question.case, folder)
    kept = question.answer(folder)
    if not kept.exists():
        machine = (case / "machine.txt").read_text(encoding="utf-8").strip()
        found = asked(question.method, case / "measured.csv", machine)
        kept.parent.mkdir(parents=True, exist_ok=True)
        write_whole(kept, found)
    score = scored(folder, question)
    return ", ".join(f"{name} {value:.3g}" for name, value in score.items())


def scored(folder: Path, question: Question) -> Score:
    """Scores of an answer that is kept."""
    truth = folder / "cases" / question.case.name / "truth.json"
    return scores(*(json.loads(path.read_text(encoding="utf-8")) for path in (truth, question.answer(folder))))


def run(
    folder: Path,
    methods: Sequence[Method],
    cases: Sequence[Case],
    workers: Workers | None = None,
    *,
    verbose: bool = False,
) -> tuple[list[str], list[list[str]]]:
    """Ask every method every case; header and rows of the table.

    Args:
        folder: of cases and answers.
        methods: whom to ask.
        cases: what to ask.
        workers: who does it.
        verbose: report every answer on stderr.
    """
    questions = [Question(method, case) for method in methods for case in cases]
    # Two methods may meet at a case that is not written yet: files of a case are the same whoever writes them.
    new = [one for one in questions if not one.answer(folder).exists()]
    for done, (index, said) in enumerate(finished(ask, folder, new, workers, name=lambda one: one.name), start=1):
        if verbose:
            sys.stderr.write(f"{done} of {len(new)}: {new[index].name}: {said}\n")
    return rows([(q.method.name, q.case.machine, q.case.kind, scored(folder, q)) for q in questions])


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
        "--kinds", nargs="+", default=list(KINDS), help=f"or how they begin: {', '.join(KINDS)}", metavar="KIND"
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
    parser.add_argument("--only-draw", action="store_true", help="write the cases, ask nothing")
    parser.add_argument("--workers", type=int, help="processes of this computer: one a core if not given")
    parser.add_argument("--scheduler", help="address of a Dask scheduler, whose workers have this folder on their path")
    found = parser.parse_args()
    found.kinds = [kind for kind in KINDS if kind.startswith(tuple(found.kinds))]
    if not found.kinds:
        parser.error(f"no such kind of case; there are {', '.join(KINDS)}")
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
    header, body = run(folder, options.method or [BUILT_IN["twin"]], cases, options.workers, verbose=True)
    (folder / "table.txt").write_text(text(header, body), encoding="utf-8")
    (folder / "table.md").write_text(markdown(header, body), encoding="utf-8")
    sys.stdout.write(text(header, body))


def write_case_in(folder: Path, case: Case) -> str:
    """Write a case and return its name."""
    return write_case(case, folder).name


if __name__ == "__main__":
    from tests.benchmark import __main__ as benchmark  # workers know it by this name

    benchmark.main()
