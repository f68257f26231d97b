"""Why data could not show a cause, however large: what of the set-up, or of the calibration's own doubt, looks the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twin.determinability import Unknown, determinability
from twin.diagnosis.pool import SEEN, Form
from twin.diagnosis.problem import Problem
from twin.diagnosis.signatures import LARGEST
from twin.identification.solve import named_setup

ITSELF: Final = "itself"


def looks_like(problem: Problem, forms: Sequence[Form], signature: np.ndarray) -> dict[tuple[str, str], str]:
    """A sentence for every candidate that none of its forms shows.

    Args:
        problem: the data.
        forms: of those candidates, all of them.
        signature: (3n, columns) of the pool they belong to.
    """
    strongest: dict[tuple[str, str], tuple[float, int]] = {}
    for form in forms:
        for column in form.columns:
            size = float(np.linalg.norm(signature[:, column]))
            if size > strongest.get(form.key, (-1.0, 0))[0]:
                strongest[form.key] = size, int(column)
    setup = named_setup(problem.setup)
    count = len(setup)
    rows = len(signature)
    doubt = problem.nuisance.shape[1] - count
    whole = np.zeros((rows + len(problem.prior), doubt + count + len(strongest)))
    whole[:, :doubt] = np.concatenate([problem.nuisance, problem.prior])[:, count:]
    whole[:rows, doubt : doubt + count] = problem.nuisance[:, :count]
    whole[:rows, doubt + count :] = signature[:, [column for _, column in strongest.values()]]
    # Triangular, the calibration's doubt first: below it stands what that doubt does not take up, and every choice among its columns
    # is a factor of theirs.
    left = np.asarray(np.linalg.qr(whole, mode="r"))[doubt:, doubt:]
    # Columns are in plausible sizes; of the cause one is a millimetre or milliradian at its largest.
    sizes = np.array([*(one.plausible * one.factor for one in setup), 1.0])
    unknowns = [*setup, Unknown(ITSELF, "", 1.0)]
    found = {}
    for k, (key, (size, _)) in enumerate(strongest.items()):
        if size**2 <= SEEN:
            found[key] = "nothing that was moved shows it"
            continue
        if float(np.linalg.norm(left[:, count + k])) ** 2 <= SEEN:
            found[key] = "the calibration itself is not known well enough"
            continue
        columns = np.array([*range(count), count + k])
        told = determinability(left[:, columns] / sizes, unknowns, tolerance=float(np.sqrt(SEEN)))
        direction = told.moving(ITSELF)
        if direction is None:
            found[key] = "stations, targets and the calibration's own doubt together take it up"
            continue
        first, *others = direction.moves
        # What makes up for it is the opposite of what it looks like.
        same = ", ".join(f"{move.name} {-move.value / first.value:+.3g} {move.unit}" for move in others)
        found[key] = f"{LARGEST * 1e-3:g} mm or mrad of it looks like {same}"
    return found
