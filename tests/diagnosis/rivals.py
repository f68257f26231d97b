"""Two standard methods on the draws of `tests.diagnosis.battery`: stepwise regression by BIC, and the LASSO.

Both get what `twin diagnose` gets: the whitened residual, and the columns of every form of every named candidate, with the set-up
projected out of both (x − QQᵀx; for a calibration without covariance, where that is a projection). Neither has an answer of its own for
"none of these"; left out is what `tests.diagnosis.battery` never hides (`UNHIDDEN`; not with ``--every``). Run rows of the table by

    python -m tests.diagnosis.rivals ROW... [--draws 50] [--noise isotropic|repeats|tracker|tracker-repeats] [--poses 390] [--seed 1]
    [--every]
                               [--workers N] [--scheduler tcp://…]

Names count as "in group" by geometry, for `twin` as for its rivals (`Design.likeness`, `ALIKE`), and not by the causes that `twin`
lists as equivalent.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import statsmodels.api as sm
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LassoLarsIC

from tests.diagnosis.battery import (
    HERE,
    ROWS,
    UNHIDDEN,
    Case,
    DataSet,
    Finding,
    Key,
    Searcher,
    Truth,
    basis_of,
    matched,
    parsed,
    task_name,
    tasks,
)
from twin.compute.parallel import Workers, map_in_order
from twin.diagnosis.candidates.candidate import Candidate, Column
from twin.diagnosis.forms import LEAST_NONCENTRALITY
from twin.diagnosis.problem import Problem

ALIKE = 0.95
"""Cosine of the angle between a hidden signature and a candidate's from which on the candidate counts as equivalent."""
SHORTLIST = 10
"""Forms a step that are fitted by statsmodels, the best by inner products."""
APART = 1e-6
"""Share of a unit direction that must be left beside the others for it to be a regressor of its own."""
STEPS = 500
"""Steps of the LASSO's path (scikit-learn's own default); its BIC is lowest far earlier."""


@dataclass(frozen=True)
class Said(Finding):
    """The result of one method for one draw.

    Attributes:
        truth: the hidden causes.
        named: the causes named.
        alike: for each named cause the hidden ones that it is equivalent to (`ALIKE`), besides itself.
        unnamed: columns of the unexplained pattern.
        seconds: processor time.
    """

    truth: tuple[Key, ...]
    named: tuple[Key, ...]
    alike: tuple[tuple[Key, ...], ...]
    unnamed: tuple[str, ...]
    seconds: float

    @property
    def in_group(self) -> bool:
        """Every hidden effect is named, or is like a cause that is: each cause stands for one."""
        return matched(list(self.truth), [{name, *like} for name, like in zip(self.named, self.alike, strict=True)])


@dataclass(frozen=True, eq=False)
class Block:
    """One form of one candidate.

    Attributes:
        key: whose it is.
        directions: (3n, w) orthonormal basis of its columns with the set-up projected out.
    """

    key: Key
    directions: np.ndarray


class Design:
    """The regressors of one data set, prepared once for all its draws.

    Directions that stay within the data's noise (below `LEAST_NONCENTRALITY`) at the largest plausible size are no
    regressors: directions absorbed by the set-up consist of rounding errors only, which a regression would scale up.

    Args:
        problem: the data.
        candidates: the causes to choose from.

    Attributes:
        blocks: one a form of which anything is seen.
        columns: (3n, p) each column of each candidate once, of length 1, for the LASSO.
        owners: (p) whose each of these is.
        gram: (p, p) their inner products.
    """

    def __init__(self, problem: Problem, candidates: Sequence[Candidate]) -> None:
        at: dict[Column, int] = {}
        owner: list[Key] = []
        for candidate in candidates:
            for column in (column for variant in candidate.variants for column in variant.columns):
                if column not in at:
                    at[column] = len(at)
                    owner.append(candidate.key)
        raw = problem.signature(list(at))
        raw[problem.held_out] = 0.0
        projected = raw - basis_of(problem) @ (basis_of(problem).T @ raw)
        gram = projected.T @ projected
        self.blocks: list[Block] = []
        for candidate in candidates:
            for variant in candidate.variants:
                own = [at[column] for column in variant.columns]
                values, vectors = np.linalg.eigh(gram[np.ix_(own, own)])
                seen = (values > LEAST_NONCENTRALITY) & (values > 1e-8 * values[-1])
                if seen.any():
                    directions = projected[:, own] @ (vectors[:, seen] / np.sqrt(values[seen]))
                    self.blocks.append(Block(candidate.key, directions))
        datum = {at[column] for candidate in candidates for column in _datum(candidate)}
        kept = np.array([i for i in range(len(at)) if gram[i, i] > LEAST_NONCENTRALITY and i not in datum], dtype=int)
        length = np.sqrt(np.diag(gram)[kept])
        self.columns = np.asfortranarray(projected[:, kept] / length)
        self.owners = [owner[i] for i in kept]
        self.gram = gram[np.ix_(kept, kept)] / np.outer(length, length)
        self._widths = sorted({block.directions.shape[1] for block in self.blocks})
        self._rows = [
            np.array([i for i, block in enumerate(self.blocks) if block.directions.shape[1] == width])
            for width in self._widths
        ]
        self._stacks = [np.concatenate([self.blocks[i].directions for i in rows], axis=1) for rows in self._rows]

    def gains(self, residual: np.ndarray, others: Sequence[Block]) -> tuple[np.ndarray, np.ndarray]:
        """(blocks) sum of squares each form takes from a projected residual beside some others, and along how many directions."""
        taken = _joined(others, len(residual))
        left = residual - taken @ (taken.T @ residual)
        explained, dof = np.zeros(len(self.blocks)), np.zeros(len(self.blocks), dtype=int)
        for width, rows, stack in zip(self._widths, self._rows, self._stacks, strict=True):
            slope = (left @ stack).reshape(-1, width)
            shared = (taken.T @ stack).reshape(-1, len(rows), width)
            own = np.eye(width) - np.einsum("tki,tkj->kij", shared, shared)
            values, vectors = np.linalg.eigh(own)
            apart = values > APART
            along = np.einsum("kij,ki->kj", vectors, slope)
            explained[rows] = np.sum(np.where(apart, along**2 / np.where(apart, values, 1.0), 0.0), axis=1)
            dof[rows] = apart.sum(axis=1)
        return explained, dof

    def likeness(self, projected: np.ndarray) -> dict[Key, float]:
        """Return the similarity of each candidate to a signature: cosine of the angle between it and the candidate's columns.

        Both with the set-up projected out; of the candidate's forms the one that comes closest, which is kind to whoever names it.

        Args:
            projected: (3n,) the signature.
        """
        found: dict[Key, float] = {}
        unit = projected / np.linalg.norm(projected)
        for width, rows, stack in zip(self._widths, self._rows, self._stacks, strict=True):
            cosines = np.linalg.norm((unit @ stack).reshape(-1, width), axis=1)
            for i, cosine in zip(rows, cosines, strict=True):
                key = self.blocks[i].key
                found[key] = max(found.get(key, 0.0), float(cosine))
        return found


def _datum(candidate: Candidate) -> Sequence[Column]:
    """The columns of a curve that are another candidate's by name: its constant (a zero or a squareness), a straightness's slope."""
    if candidate.space is None:
        return ()
    return candidate.variants[0].columns[: 2 if candidate.effect == "straightness" else 1]


def _joined(blocks: Sequence[Block], rows: int) -> np.ndarray:
    """(3n, r) orthonormal basis of several forms together."""
    if not blocks:
        return np.zeros((rows, 0))
    u, values, _ = np.linalg.svd(np.concatenate([block.directions for block in blocks], axis=1), full_matrices=False)
    return np.asarray(u[:, values**2 > APART])


def stepwise_bic(
    problem: Problem,
    candidates: Sequence[Candidate],
    *,
    design: Design | None = None,
    shortlist: int = SHORTLIST,
    extended: bool = False,
) -> tuple[Key, ...]:
    """Forward and backward selection by BIC.

    A candidate comes in with one of its forms, all columns of it in one block. Each step adds the form, or gives a candidate that is
    in the other form, with which the BIC of an ordinary regression (`statsmodels.api.OLS`, noise estimated, n the number of readings,
    k the number of identifiable parameters) is lowest; then forms are removed while that lowers it. It ends when the BIC does not
    fall. Which forms of a step are fitted is settled by inner products: these give each form's residual sum of squares, hence the same
    order.

    Args:
        problem: the data.
        candidates: the causes to choose from.
        design: their regressors, perhaps with others', where they are at hand.
        shortlist: how many forms are fitted a step.
        extended: add 2·log of the number of sets of that many candidates (EBIC with γ = 1: Chen and Chen, Biometrika 95, 2008), what
            BIC does not charge for a long list.

    Returns:
        What comes in, in the order it came.
    """
    own = design or Design(problem, candidates)
    residual = problem.projected
    n = len(residual)
    allowed = {candidate.key for candidate in candidates}
    choice = len({block.key for block in own.blocks} & allowed)

    def charge(count: int) -> float:
        """2·log of (choice over count)."""
        steps = np.arange(count)
        return 2.0 * float(np.sum(np.log((choice - steps) / (steps + 1.0)))) if extended else 0.0

    def criterion(chosen: Sequence[Block]) -> float:
        if not chosen:
            # statsmodels fits nothing to no regressors: the same formula by hand.
            return n * float(np.log(2.0 * np.pi * residual @ residual / n) + 1.0)
        # An orthonormal basis of their columns: the same fit, and none twice where forms share directions.
        return float(sm.OLS(residual, _joined(chosen, n), hasconst=False).fit().bic) + charge(len(chosen))

    chosen: list[Block] = []
    now = criterion(chosen)
    while True:
        trials: list[tuple[float, list[Block]]] = []
        inside = {block.key for block in chosen}
        # Candidate forms and the forms kept with them: a new candidate with all, another form of a selected one with the others.
        for leaver in (None, *chosen):
            others = [block for block in chosen if block is not leaver]
            explained, dof = own.gains(residual, others)
            basis = _joined(others, n)
            squares = float(np.sum((residual - basis @ (basis.T @ residual)) ** 2))
            foretold = n * np.log(np.maximum(squares - explained, 1e-300) / n) + np.log(n) * (basis.shape[1] + dof)
            foretold += charge(len(others) + 1)
            keys = allowed - inside if leaver is None else {leaver.key}
            free = [block.key in keys for block in own.blocks]
            foretold = np.where(np.array(free) & (dof > 0), foretold, np.inf)
            best = [int(i) for i in np.argsort(foretold, kind="stable")[:shortlist] if np.isfinite(foretold[i])]
            trials += [(float(foretold[i]), [*others, own.blocks[i]]) for i in best if own.blocks[i] is not leaver]
        trials.sort(key=lambda trial: trial[0])
        fitted = [(criterion(trial), trial) for _, trial in trials[:shortlist]]
        if not fitted:
            break
        least, grown = min(fitted, key=lambda one: one[0])
        if least >= now:
            break
        now, chosen = least, grown
        while len(chosen) > 1:
            smaller = [[block for block in chosen if block is not gone] for gone in chosen]
            least, shrunk = min(((criterion(trial), trial) for trial in smaller), key=lambda one: one[0])
            if least >= now:
                break
            now, chosen = least, shrunk
    return tuple(block.key for block in chosen)


def lasso(problem: Problem, candidates: Sequence[Candidate], *, design: Design | None = None) -> tuple[Key, ...]:
    """The LASSO (`sklearn.linear_model.LassoLarsIC`) at the step of its path with the lowest BIC.

    All columns of all forms are offered at once, each scaled to length 1 after the projection; the noise is given (1, the
    residual is whitened) instead of estimated. Left out are columns that are another candidate's by name (`_datum`): the LASSO, which
    knows no forms, would have to toss a coin between a squareness and an angular error's constant. A candidate is named if any of its
    columns is used. This is the LASSO's best showing among what was tried on other draws: with one form a candidate (the best alone)
    it names a false cause beside the right one twice as often; with ordinary regression on the columns of each step, or with
    cross-validation (`LassoCV`), it names several causes in every draw without any.

    Args:
        problem: the data.
        candidates: the causes to choose from.
        design: their columns, perhaps with others', where they are at hand.

    Returns:
        Who is named, the largest column first.
    """
    own = design or Design(problem, candidates)
    allowed = {candidate.key for candidate in candidates}
    among = np.array([i for i, key in enumerate(own.owners) if key in allowed], dtype=int)
    columns, gram = own.columns[:, among], own.gram[np.ix_(among, among)]
    model = LassoLarsIC(
        criterion="bic", fit_intercept=False, precompute=gram, max_iter=STEPS, noise_variance=1.0, copy_X=False
    )
    with warnings.catch_warnings():
        # For identical columns the path takes one, with a warning.
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(columns, problem.projected)
    size = np.abs(model.coef_)
    return tuple(dict.fromkeys(own.owners[among[i]] for i in np.argsort(-size, kind="stable") if size[i] > 0.0))


def compared(
    row: str,
    draws: int,
    seed: int,
    *,
    noise: str = "isotropic",
    poses: int = 390,
    every: bool = False,
    workers: Workers = HERE,
) -> dict[str, list[Said]]:
    """The draws of `tests.diagnosis.battery.answers` with the same seed, and what `twin` and its rivals say of each.

    Seconds are those of one answer, columns and their inner products at hand.

    Args:
        row: of the table.
        draws: how many.
        seed: of all of them.
        noise: as in `tests.diagnosis.battery.measured`.
        poses: as in `tests.diagnosis.battery.measured`.
        every: the rivals choose among all that `twin` does, also `UNHIDDEN`. That is harder than it need be: a misplaced curve is so
            with a share of one or not at all, which `twin` asks for and a plain regression cannot.
        workers: who does it.
    """
    case = Case(row, seed, noise, poses, every=every)
    found: dict[str, list[Said]] = {}
    for said in map_in_order(said_of, case, tasks(draws), workers, name=task_name):
        for method, some in said.items():
            found.setdefault(method, []).extend(some)
    return found


def said_of(case: Case, task: tuple[int, int]) -> dict[str, list[Said]]:
    """Return the results for one data set, by method."""
    number, draws = task
    data = DataSet(case, number)
    problem, searcher = data.problem, data.searcher
    candidates = searcher.task.catalogue.candidates
    design = Design(problem, candidates)
    choice = [candidate for candidate in candidates if case.every or candidate.effect not in UNHIDDEN]
    found: dict[str, list[Said]] = {}
    for _ in range(draws):
        draw = data.draw()
        problem.set_residual(draw.residual)
        for method, ask in _methods(problem, searcher, choice, design).items():
            began = time.process_time()
            named, unnamed = ask()
            seconds = time.process_time() - began
            found.setdefault(method, []).append(_said(problem, design, draw.truth, named, unnamed, seconds))
    return found


def _methods(
    problem: Problem, searcher: Searcher, known: Sequence[Candidate], design: Design
) -> dict[str, Callable[[], tuple[tuple[Key, ...], tuple[str, ...]]]]:
    """Return the methods by name: functions that return the causes named and the columns of unexplained patterns."""

    def own() -> tuple[tuple[Key, ...], tuple[str, ...]]:
        searcher.candidates.set_problem(problem)
        found = searcher.run().structure
        unnamed = (name for pattern_test in found.pattern_tests for name in pattern_test.pattern.names)
        return tuple(form.key for form in found.forms), tuple(unnamed)

    return {
        "twin": own,
        "stepwise BIC": lambda: (stepwise_bic(problem, known, design=design), ()),
        "stepwise EBIC": lambda: (stepwise_bic(problem, known, design=design, extended=True), ()),
        "LASSO": lambda: (lasso(problem, known, design=design), ()),
    }


def _said(
    problem: Problem,
    design: Design,
    truth: Sequence[Truth],
    named: tuple[Key, ...],
    unnamed: tuple[str, ...],
    seconds: float,
) -> Said:
    like = {
        key: design.likeness(signature - basis_of(problem) @ (basis_of(problem).T @ signature))
        for key, signature, *_ in truth
    }
    alike = tuple(tuple(key for key in like if key != name and like[key].get(name, 0.0) >= ALIKE) for name in named)
    return Said(tuple(like), named, alike, unnamed, seconds)


def summary(row: str, found: Sequence[Said]) -> dict[str, float]:
    """Shares of the draws, as `tests.diagnosis.battery.summary` has them where a method without intervals and groups can have them."""

    def share(values: list[bool]) -> float:
        return float(np.mean(values))

    always = {
        "causes named": float(np.mean([len(a.named) for a in found])),
        "seconds": float(np.mean([a.seconds for a in found])),
    }
    if row == "nothing":
        return {"any alarm": share([bool(a.named or a.unnamed) for a in found])} | always
    if row.startswith("outside"):
        return {
            "any cause named": share([bool(a.named) for a in found]),
            "unexplained": share([bool(a.unnamed) for a in found]),
        } | always
    return {
        "right": share([a.right for a in found]),
        "right or in group": share([a.in_group for a in found]),
        "an effect too many": share([a.too_many for a in found]),
        "right or in group, and no more": share([a.in_group and not a.too_many and not a.unnamed for a in found]),
        "nothing found": share([not a.named and not a.unnamed for a in found]),
    } | always


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", nargs="+", choices=ROWS)
    parser.add_argument("--draws", type=int, default=50)
    parser.add_argument("--noise", default="isotropic", choices=["isotropic", "repeats", "tracker", "tracker-repeats"])
    parser.add_argument("--poses", type=int, default=390)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--every", action="store_true")
    options, workers = parsed(parser)
    for row in options.rows:
        said = compared(
            row,
            options.draws,
            options.seed,
            noise=options.noise,
            poses=options.poses,
            every=options.every,
            workers=workers,
        )
        for method, found in said.items():
            shares = ", ".join(f"{name} {value:.3g}" for name, value in summary(row, found).items())
            sys.stdout.write(f"{row} {options.noise} {len(found)} {method}: {shares}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    from tests.diagnosis import rivals  # workers know it by this name

    rivals.main()
