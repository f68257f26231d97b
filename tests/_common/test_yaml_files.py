"""YAML files: the C parser reads what PyYAML's own parser reads."""

from pathlib import Path

import pytest

import twin
from twin._common import yaml_files
from twin._common.errors import InputError
from twin._common.yaml_files import read_yaml

TEXTS = (
    "plain: 1e3\nquoted: '1e3'\nfloat: 1.5e+3\nwhole: 0x10\nyes: true\nnothing:\n",
    "a: &x [1, 2.5]\nb: *x\nc:\n- {d: 1, e: '2'}\n- |\n  text\n",
    "x: 2026-11-25\n<<: {y: 1}\nµ: 'ü'\n",
    "a: 1\nb: [1, 2\n",
    "a: 1\n\tb: 2\n",
    "a: \x07\n",
    "a: " + "[" * 40 + "]" * 40,
    "--- 1\n--- 2\n",
    "",
)


def _read(path: Path) -> tuple[object, ...]:
    try:
        data, lines = read_yaml(path)
    except InputError as error:
        return "refused", str(error)
    return data, dict(lines)


@pytest.mark.skipif(yaml_files._FastLoader is None, reason="PyYAML without its C parser")
def test_both_parsers_read_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = []
    for i, text in enumerate(TEXTS):
        written.append(tmp_path / f"{i}.yaml")
        written[-1].write_text(text, encoding="utf-8")
    files = [*written, *Path(twin.__file__).parent.rglob("*.yaml")]
    fast = [_read(file) for file in files]
    monkeypatch.setattr(yaml_files, "_FastLoader", None)
    assert fast == [_read(file) for file in files]
