"""Test cases for each format of control tables, one module each.

Every module has an evaluation of the files that shares no code with `twin` and follows the control's documentation (`by_hand`, which
agrees to `AGREES_UM`), valid files (`GOOD`) and changes that make them invalid (`BAD`).
"""

from importlib import import_module

from twin.controls import table_formats

CASES = {form.name: import_module(f"{__name__}.{form.name}") for form in table_formats()}
BY_HAND = {name: case.by_hand for name, case in CASES.items()}
