"""Why data could not show a cause, however large: what of the set-up, or of the calibration's own doubt, looks the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twin.diagnosis.candidates.signatures import LARGEST
from twin.diagnosis.problem.pool import SEEN, Form
from twin.diagnosis.problem.problem import Problem
from twin.identification.solve import named_setup
from twin.numerics.observability import Unknown, determinability

ITSELF: Final = "itself"


def looks_like(problem: Problem, forms: Sequence[Form]) -> dict[tuple[str, str], str]:
    """A sentence for every candidate that none of its forms shows.

    Args:
        problem: the data.
        forms: of those candidates, all of them.
    """
    every = list(dict.fromkeys((form.key, column) for form in forms for column in form.cell.columns))
    if not every:
        return {}
    found = problem.products([column for _, column in every])
    # Beside the set-up there is next to nothing of them; what there was before is what the basis has of it, too.
    sizes_of = np.sqrt(np.maximum(np.diag(found.gram), 0.0) + np.sum(found.basis**2, axis=0))
    strongest: dict[tuple[str, str], tuple[float, int]] = {}
    for i, ((key, _), size) in enumerate(zip(every, sizes_of.tolist(), strict=True)):
        if size > strongest.get(key, (-1.0, 0))[0]:
            strongest[key] = size, i
    own = [i for _, i in strongest.values()]
    setup = named_setup(problem.setup)
    count, doubt = len(setup), len(problem.prior)
    # All of it in the directions of the basis, and what of the causes is beside them.
    values, vectors = np.linalg.eigh(found.gram[np.ix_(own, own)])
    beside = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    whole = np.zeros((len(problem.back) + len(own), doubt + count + len(own)))
    whole[: len(problem.back)] = np.concatenate(
        [problem.back[:, count:], problem.back[:, :count], found.basis[:, own]], axis=1
    )
    whole[len(problem.back) :, doubt + count :] = beside
    # Triangular, the calibration's doubt first: below it stands what that doubt does not take up, and every choice among its columns
    # is a factor of theirs.
    left = np.asarray(np.linalg.qr(whole, mode="r"))[doubt:, doubt:]
    # Columns are in plausible sizes; of the cause one is a millimetre or milliradian at its largest.
    sizes = np.array([*(one.plausible * one.factor for one in setup), 1.0])
    unknowns = [*setup, Unknown(ITSELF, "", 1.0)]
    said = {}
    for k, (key, (size, _)) in enumerate(strongest.items()):
        if size**2 <= SEEN:
            said[key] = "nothing that was moved shows it"
            continue
        if float(np.linalg.norm(left[:, count + k])) ** 2 <= SEEN:
            said[key] = "the calibration itself is not known well enough"
            continue
        columns = np.array([*range(count), count + k])
        told = determinability(left[:, columns] / sizes, unknowns, tolerance=float(np.sqrt(SEEN)))
        direction = told.moving(ITSELF)
        if direction is None:
            said[key] = "stations, targets and the calibration's own doubt together take it up"
            continue
        first, *others = direction.moves
        # What makes up for it is the opposite of what it looks like.
        same = ", ".join(f"{move.name} {-move.value / first.value:+.3g} {move.unit}" for move in others)
        said[key] = f"{LARGEST * 1e-3:g} mm or mrad of it looks like {same}"
    return said
