"""Short Markov chains, for tests whose result does not depend on their length."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from twin.thermal.evidence import DrawnModels, Evidence


@contextmanager
def short_chains() -> Iterator[None]:
    """Draw a fortieth of the thermal models: a fit with all of them, cross-validated, takes 10 s."""
    draw = Evidence.draw

    def draw_few(self: Evidence, generator: np.random.Generator, steps: int) -> DrawnModels:
        return draw(self, generator, steps // 40)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Evidence, "draw", draw_few)
        yield
