"""Scores of one answer against the truth of its case, and their means over many cases."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

FACTOR: Final = 1.96
"""Coverage factor of a 95 % interval of a normal distribution."""
SCORES: Final = {
    "right": "every hidden effect is named at its location",
    "in group": "every hidden effect is named, or in `equivalent` of a cause of its own",
    "group size": "number of effects in a cause: itself and its `equivalent`",
    "size": "parameters within 1.96 u of the truth, for causes named right",
    "gain": "held-out residual smaller with the causes than without, if a hidden machine cause is named",
    "removed": "share of the true error's sum of squares that the written calibration removes",
    "too many": "more causes than hidden effects",
    "false machine": "a machine cause of which neither the effect nor any of its `equivalent` is hidden",
    "unexplained": "the verdict is `unexplained`; together with a known effect, `unexplained` is given",
    "right column": "`unexplained.depends_on` contains a column of the pattern",
    "alarm": "a verdict other than `consistent` if nothing is hidden",
    "no answer": "the method failed",
    "seconds": "wall time, one thread",
}
"""Scores of an answer by name, with their meaning."""
Score = dict[str, float]
Key = tuple[str, str]


def scores(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> Score:
    """Return the scores that apply to a case; a missing answer is neither right nor an alarm.

    Args:
        truth: content of ``truth.json``.
        answer: result of `tests.scored_cases.methods.run_method`.
    """
    found: Score = {"no answer": float(answer["diagnosis"] is None), "seconds": float(answer["seconds"])}
    said = answer["diagnosis"] or {"verdict": None, "causes": [], "unexplained": None, "gain": None}
    hidden = [(one["effect"], one["where"]) for one in truth["effects"]]
    causes = said["causes"]
    named = [(cause["effect"], cause["where"]) for cause in causes]
    groups = [{key, *_equivalent(cause)} for key, cause in zip(named, causes, strict=True)]
    found["false machine"] = float(
        any(c["origin"] == "machine" and not group & set(hidden) for c, group in zip(causes, groups, strict=True))
    )
    if answer.get("removed") is not None:
        found["removed"] = float(answer["removed"])
    if groups:
        found["group size"] = sum(len(group) for group in groups) / len(groups)
    if hidden:
        found |= {"right": float(set(hidden) <= set(named)), "in group": float(matched(hidden, groups))}
        found["too many"] = float(len(causes) > len(hidden))
        found |= _sizes(truth, causes) | _gain(truth, said)
    if truth["outside"] is not None:
        left = said.get("unexplained")
        found["unexplained"] = float(left is not None if hidden else said["verdict"] == "unexplained")
        columns = set(left["depends_on"]) if left else set()
        found["right column"] = float(bool(columns & set(truth["outside"]["depends_on"])))
    elif not hidden:
        found["alarm"] = float(said["verdict"] not in ("consistent", None))
    return found


def _equivalent(cause: Mapping[str, Any]) -> list[Key]:
    return [(one["effect"], one["where"]) for one in cause.get("equivalent", [])]


def matched(hidden: Sequence[Key], groups: Sequence[set[Key]]) -> bool:
    """Return whether every hidden effect can be assigned to a different group that contains it."""
    if not hidden:
        return True
    rest = list(groups)
    return any(hidden[0] in group and matched(hidden[1:], rest[:i] + rest[i + 1 :]) for i, group in enumerate(groups))


def _sizes(truth: Mapping[str, Any], causes: Sequence[Mapping[str, Any]]) -> Score:
    """Return the share of parameters within their interval, for right causes with parameters."""
    inside: list[bool] = []
    for one in truth["effects"]:
        cause = next((c for c in causes if (c["effect"], c["where"]) == (one["effect"], one["where"])), None)
        if cause is None or not cause.get("parameters"):
            continue
        said = {p["name"]: p for p in cause["parameters"]}
        true = {p["name"]: p["value"] for p in one["parameters"]}
        # A curve of higher degree has further coefficients, whose true value is zero.
        for name in {**true, **said}:
            inside.append(name in said and _covered(name, said[name], true.get(name, 0.0)))
    return {"size": sum(inside) / len(inside)} if inside else {}


def _covered(name: str, said: Mapping[str, Any], true: float) -> bool:
    if said["value"] is None or said["u"] is None:
        return False
    off = said["value"] - true
    if name == "phase":
        off = math.remainder(off, 2.0 * math.pi)
    return abs(off) <= FACTOR * said["u"] + 1e-9 * abs(true)


def _gain(truth: Mapping[str, Any], said: Mapping[str, Any]) -> Score:
    there = {(one["effect"], one["where"]) for one in truth["effects"] if one["origin"] == "machine"}
    right = any((cause["effect"], cause["where"]) in there for cause in said["causes"])
    held = (said.get("gain") or {}).get("held_out")
    before, after = (held.get(f"rms_{when}_um") for when in ("before", "after")) if held else (None, None)
    if not right or before is None or after is None:
        return {}
    return {"gain": float(after < before)}


def probabilities(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> list[tuple[float, bool]]:
    """Return the stated probability of every cause that has one, and whether it or one of its equivalents is hidden."""
    hidden = {(one["effect"], one["where"]) for one in truth["effects"]}
    causes = (answer["diagnosis"] or {"causes": []})["causes"]
    groups = [({(cause["effect"], cause["where"]), *_equivalent(cause)}, cause.get("probability")) for cause in causes]
    return [(probability, bool(group & hidden)) for group, probability in groups if probability is not None]


def is_wrong(score: Score) -> bool:
    """Return whether an answer is wrong, sizes and gain not considered."""
    bad = ("no answer", "alarm", "too many", "false machine")
    good = ("in group", "unexplained", "right column")
    return any(score.get(name, 0.0) > 0.0 for name in bad) or any(score.get(name, 1.0) < 1.0 for name in good)


def in_words(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> str:
    """Return hidden errors and answer in one line."""
    hidden = [f"{one['effect']} {one['where']}" for one in truth["effects"]]
    if truth["outside"] is not None:
        pattern = truth["outside"]
        hidden.append(f"{pattern['pattern']} of {' and '.join(pattern['columns'])} on the {pattern['side']} side")
    said = answer["diagnosis"]
    if said is None:
        return f"{', '.join(hidden) or 'nothing'} → no answer: {answer['error']}"
    named = [" or ".join(" ".join(key) for key in [(c["effect"], c["where"]), *_equivalent(c)]) for c in said["causes"]]
    if said.get("unexplained"):
        named.append(f"unexplained by {', '.join(said['unexplained']['depends_on'])}")
    return f"{', '.join(hidden) or 'nothing'} → {said['verdict']}: {', '.join(named) or 'nothing'}"


def mean(found: Sequence[Score], name: str) -> float:
    """Return the mean of a score over the answers that have it; NaN if none has."""
    values = [one[name] for one in found if name in one]
    return sum(values) / len(values) if values else math.nan
