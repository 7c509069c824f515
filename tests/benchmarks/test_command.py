from pathlib import Path

import pytest

from benchmarks.command import run


def test_a_figure_belongs_to_the_accuracy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ending:
        run(["--figure", str(tmp_path)])
    assert ending.value.code == 2
    assert "--figure needs --accuracy" in capsys.readouterr().err
