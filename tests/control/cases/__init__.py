"""What the tests know of each format, a module each: a reading of its files by a few lines that share no code with `twin` and follow
the control's own words (`by_hand`, to `AGREES_UM`), files that are read (`GOOD`) and what makes them wrong (`BAD`)."""

from importlib import import_module

from twin.machine.control import FORMATS

CASES = {form.name: import_module(f"{__name__}.{form.name}") for form in FORMATS}
BY_HAND = {name: case.by_hand for name, case in CASES.items()}
