"""Terms that a person can name: the average model's candidates summed by input, with their uncertainty and their alternatives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twin.thermal.candidates import TermCandidate
from twin.thermal.evidence import Average, DrawnModels
from twin.thermal.model import ThermalTerm

CERTAIN: Final = 0.95
"""Share of the models above which an input has no alternatives."""
LISTED: Final = 1.0
"""Least contribution of a term that matters, in standard deviations of the residual."""


def input_name(term: TermCandidate) -> str:
    """Return the name of the input that a candidate follows."""
    if term.sensors:
        return term.sensors[0] if len(term.sensors) == 1 else f"group {', '.join(term.sensors)}"
    return "drift" if term.effect == "thermal_drift" else "speed"


def named_terms(
    displacement: str,
    candidates: Sequence[TermCandidate],
    x: np.ndarray,
    draws: DrawnModels,
    average: Average,
    factor: float,
) -> tuple[ThermalTerm, ...]:
    """Return the terms of a displacement, by falling contribution.

    Args:
        displacement: its name.
        candidates: all candidates.
        x: candidates over the fitted rows (n, candidates).
        draws: the models drawn for its group.
        average: its average.
        factor: factor of the standard uncertainties, from held-out data.
    """
    families: dict[tuple[str, str], list[int]] = {}
    for j, term in enumerate(candidates):
        families.setdefault((term.effect, input_name(term)), []).append(j)
    followed = [{input_name(candidates[j]) for j in model} for model in draws.models]
    found = []
    for (effect, name), members in families.items():
        index = np.array(members)
        weight = average.mean[index] ** 2 + np.diag(average.covariance)[index]
        if weight.sum() <= 0.0:
            continue
        weight = weight / weight.sum()
        tau = np.array([candidates[j].time_constant_s for j in members])
        centre = float(weight @ tau)
        moved = x[:, index] @ average.mean[index]
        share, others = _share(name, followed)
        contribution = float(moved.std())
        found.append(
            ThermalTerm(
                effect=effect,
                name=f"{displacement} by {name}" if candidates[members[0]].sensors else displacement,
                input=name,
                coefficient=float(average.mean[index].sum()),
                standard_uncertainty=factor * float(np.sqrt(max(average.covariance[np.ix_(index, index)].sum(), 0.0))),
                time_constant_s=centre,
                u_time_constant_s=float(np.sqrt(weight @ (tau - centre) ** 2)),
                exponent=float(weight @ [candidates[j].exponent for j in members])
                if effect.startswith("spindle")
                else None,
                share=share,
                alternatives=others,
                contribution_um=contribution,
                matters=contribution > LISTED * average.residual_um,
            )
        )
    return tuple(sorted(found, key=lambda term: -term.contribution_um))


def _share(name: str, followed: Sequence[set[str]]) -> tuple[float, tuple[str, ...]]:
    """Return the share of the models that follow an input, and the inputs that the others follow clearly more often."""
    having = [names for names in followed if name in names]
    lacking = [names for names in followed if name not in names]
    share = len(having) / len(followed)
    if not lacking or share > CERTAIN:
        return share, ()
    found = []
    for other in sorted({one for names in lacking for one in names}):
        without = sum(other in names for names in lacking) / len(lacking)
        beside = sum(other in names for names in having) / max(len(having), 1)
        if having and without > 0.3 and without > beside + 0.15:
            found.append((beside - without, other))
    return share, tuple(other for _, other in sorted(found))
