"""The examples of the public API run as written, and print what they say."""

from __future__ import annotations

import doctest
import inspect
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
import pytest

import twin

WITHOUT_EXAMPLE = {
    "__version__": "a text",
    "identification_plots": "in the example of `identify`, whose result it draws",
    "diagnosis_plots": "in the example of `diagnose`, whose result it draws",
}
"""Names of the API that need no example, with the reason."""
FINDER = doctest.DocTestFinder(recurse=False)


def documented(name: str) -> Iterator[tuple[str, Any]]:
    """Yield a member of the API, and the public methods of a class, with their names."""
    value = getattr(twin, name)
    yield f"twin.{name}", value
    for method, attribute in vars(value).items() if inspect.isclass(value) else ():
        function = getattr(attribute, "__func__", attribute)  # of a class method
        if not method.startswith("_") and isinstance(function, FunctionType):
            yield f"twin.{name}.{method}", function


def examples(name: str) -> list[doctest.DocTest]:
    known = {"twin": twin, "np": np}
    tests = (test for title, value in documented(name) for test in FINDER.find(value, title, globs=dict(known)))
    return [test for test in tests if test.examples]


@pytest.mark.parametrize("name", sorted(set(twin.__all__) - set(WITHOUT_EXAMPLE)))
def test_examples(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    tests = examples(name)
    assert tests, f"twin.{name} has no example"
    printed: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.FAIL_FAST)
    for test in tests:
        runner.run(test, out=printed.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(printed)
