"""YAML files: both parsers read the same, and every text that is written is read back."""

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import twin
from twin._common import yaml_files
from twin._common.errors import InputError, control_character
from twin._common.files import scratch_folder
from twin._common.yaml_files import quoted, read_yaml, yaml_text
from twin.measurement.importing.mapping import ColumnMapping, ColumnsFile, entry_of
from twin.model.calibration_file import UnidentifiedEntry

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


LOOK_ALIKES = (
    *("NAN", "NaN", ".nan", "inf", "-Infinity", ".inf", "yes", "No", "on", "y", "1e3", "1E-3", "-.5e2", "1.", "012"),
    *("0o7", "0x10", "1_000", "1_0.5", "null", "~", "Null", "", " ", "true", "2026-11-27", "2026-11-27 10:00:00"),
    *("12:30", "1:20:30.5", "<<", "=", "!x", "a: b", "a #b", "- a", "'", '"', "it's", "a\nb", "\n", "a\r\nb", "a\tb"),
    *("\ttab", " lead", "trail ", "%", "@x", "&a", "*a", "[", "{}", "µm", "測定", "😀", "\u00a0", "１２", "a" * 300),
    *("word " * 60, "1" * 500, "---", "...", "?", "|", ">"),
)
TEXT = st.one_of(
    st.sampled_from(LOOK_ALIKES),
    st.text(st.characters(exclude_categories=["Cs"]), max_size=40),
    st.from_regex(r"[-+]?[0-9_.:eExo]{1,8}", fullmatch=True),
).filter(lambda text: control_character(text) is None)  # a file with one is refused


def _back(text: str) -> object:
    with scratch_folder() as folder:
        path = folder / "f.yaml"
        path.write_bytes(text.encode())
        return read_yaml(path)[0]


@given(TEXT, TEXT)
def test_texts_are_written_and_read_back(key: str, text: str) -> None:
    """As a value, a list's item and a key: whatever looks like a number, a date or true stays text."""
    data = {"schema": "x", "plain": text, "list": [text, "", 1, 2.5, True], "map": {key: {"name": text}}}
    assert _back(yaml_text(data)) == data
    assert _back(f"a: {quoted(text)}\n") == {"a": text}


@settings(max_examples=15)  # each writes and reads two files
@given(TEXT)
def test_every_writer_keeps_texts(text: str) -> None:
    machine = twin.Machine.load("dmu50")
    plain = twin.Calibration.zero(machine)
    entry = UnidentifiedEntry(name="E_XX", why=text or "none")
    written = replace(plain, source=text, not_identifiable=(entry,), instruments=(text,))
    mapping = ColumnMapping(
        ColumnsFile(file=text, sheet=text, columns={"X_mm": entry_of(text, unit="mm"), "target": entry_of(value=text)})
    )
    with scratch_folder() as folder:
        written.save(folder / "c.yaml")
        found = twin.Calibration.load(folder / "c.yaml", machine)
        assert (found.source, found.instruments, found.not_identifiable) == (text, (text,), (entry,))
        (folder / "m.yaml").write_bytes(mapping.to_yaml({}, []).encode())
        assert ColumnMapping.load(folder / "m.yaml", machine).entries == mapping.entries


def test_one_module_writes_yaml() -> None:
    """The writers of calibrations, thermal models and mappings have no dumper of their own, whose texts no test reads back."""
    folder = Path(twin.__file__).parent
    own = [
        path.name
        for path in folder.rglob("*.py")
        if "yaml.dump" in path.read_text() or "yaml.safe_dump" in path.read_text()
    ]
    assert own == ["yaml_files.py"]
