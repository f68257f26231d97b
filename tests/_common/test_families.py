"""Tests of the tables of names: each name is that of the member behind it."""

from __future__ import annotations

from collections.abc import Collection

import pytest

from twin._common import families
from twin.controls import kinematics_formats, table_formats
from twin.measurement.formats import FORMATS as MEASURED_FORMATS
from twin.measurement.instruments import INSTRUMENTS
from twin.model.effects import MACHINE_EFFECTS
from twin.nc import DIALECTS
from twin.planning.drift import DRIFTS
from twin.planning.sequences.moves import SEQUENCES
from twin.planning.sequences.specification import SET_UPS


@pytest.mark.parametrize(
    ("table", "found"),
    [
        (families.INSTRUMENTS, INSTRUMENTS),
        (families.MEASURED_FORMATS, MEASURED_FORMATS),
        (families.TABLE_FORMATS, table_formats()),
        (families.KINEMATICS_FORMATS, kinematics_formats()),
        (families.EFFECTS, MACHINE_EFFECTS),
        (families.SEQUENCES, SEQUENCES),
        (families.DRIFTS, DRIFTS),
        (families.PROGRAM_SUFFIXES, DIALECTS),
    ],
)
def test_members_have_the_names_of_their_table(table: Collection[str], found: tuple[object, ...]) -> None:
    assert [getattr(one, "name") for one in found] == list(table)  # noqa: B009


def test_a_wrong_name_is_found() -> None:
    with pytest.raises(LookupError, match="no member of the name 'levels'"):
        families.members("twin.measurement.instruments", {"levels": "points:Level"})


def test_names_refer_to_members() -> None:
    assert set(families.SEQUENCE_INSTRUMENTS) == set(SET_UPS) <= set(families.INSTRUMENTS)
