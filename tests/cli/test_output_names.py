"""The suffix of an output must fit its format; otherwise it is refused before any computation, and nothing is written."""

from __future__ import annotations

from pathlib import Path

import pytest

from twin import cli


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("scene", "cone_frustum.nc", "-o", "out.png"), ".html or .htm"),
        (("scene", "cone_frustum.nc", "-o", "out"), ".html or .htm"),
        (("report", "-o", "out.pdf"), ".html or .htm"),
        (("identify", "measured.csv", "-o", "out.csv"), ".yaml or .yml"),
        (("axis-run", "measured.csv", "-l", "measured.csv", "-o", "out.json"), ".yaml or .yml"),
        (("diagnose", "measured.csv", "--html", "out.pdf"), ".html or .htm"),
        (("evaluate", "measured.csv", "--html", "out.pdf"), ".html or .htm"),
        (("watch", ".", "--html", "out.pdf"), ".html or .htm"),
        (("diagnose", "measured.csv", "--extended", "out.html"), ".yaml or .yml"),
        (("thermal", "measured.csv", "-o", "out.csv"), ".yaml or .yml"),
        (("thermal", "measured.csv", "--predicted", "out.yaml"), ".csv"),
        (("thermal", "measured.csv", "--html", "out.pdf"), ".html or .htm"),
        (("simulate", "thesis_plan.csv", "-o", "out.yaml"), ".csv"),
        (("simulate-run", "-l", "measured.csv", "--positions", "0,100,5", "-o", "out.xlsx"), ".csv"),
        (("plan", "-o", "out.nc"), ".csv"),
        (("plan", "-o", "out.csv", "--instrument", "probe", "--program", "out.txt"), ".ngc"),
        (("plan", "--drift", "environment", "-o", "out.nc"), ".csv"),
        (("evaluate", "measured.csv", "--iso230-3", "--html", "out.pdf"), ".html or .htm"),
        (("import", "measured.csv", "-o", "out.xlsx"), ".csv"),
        (("convert", "measured.csv", "-o", "out.rtl"), ".csv"),
        (("compensate", "cone_frustum.nc", "-o", "out.png"), ".nc .ngc"),
        (("path", "cone_frustum.nc", "-o", "out.pdf"), ".nc .ngc"),
    ],
    ids=lambda one: " ".join(one) if isinstance(one, tuple) else "",
)
def test_wrong_suffix(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    expected: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "measured.csv").write_text("")
    with pytest.raises(SystemExit) as ended:
        cli.main(list(words))
    said = capsys.readouterr()
    assert ended.value.code == 2 and said.out == "" and said.err.count("\n") == 1
    assert f"name ending in {expected}" in said.err or f"name ending in one of {expected}" in said.err
    assert [path.name for path in tmp_path.iterdir()] == ["measured.csv"]
