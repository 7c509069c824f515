from pathlib import Path

import pytest

from palletloc.io.atomic import OutputError, write_bytes, write_text, written_beside


def test_a_file_is_replaced_and_nothing_stays_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "result.csv"
    write_text(path, "before")
    write_bytes(path, b"after")
    assert [p.name for p in tmp_path.iterdir()] == ["result.csv"]
    assert path.read_text() == "after"


def test_missing_parents_are_made(tmp_path: Path) -> None:
    write_text(tmp_path / "a" / "b" / "result.csv", "here")
    assert (tmp_path / "a" / "b" / "result.csv").read_text() == "here"


@pytest.mark.parametrize("kind", [RuntimeError, KeyboardInterrupt])
def test_an_exception_leaves_the_earlier_file_alone(tmp_path: Path, kind: type[BaseException]) -> None:
    path = tmp_path / "result.csv"
    write_text(path, "before")

    def interrupted() -> None:
        with written_beside(path) as partial:
            partial.write_text("half of it")
            raise kind

    with pytest.raises(kind):
        interrupted()
    assert [p.name for p in tmp_path.iterdir()] == ["result.csv"]
    assert path.read_text() == "before"


@pytest.mark.parametrize("kind", [RuntimeError, KeyboardInterrupt])
def test_an_exception_leaves_no_half_folder(tmp_path: Path, kind: type[BaseException]) -> None:
    def interrupted() -> None:
        with written_beside(tmp_path / "recording") as partial:
            write_text(partial / "images" / "0.txt", "one of two")
            raise kind

    with pytest.raises(kind):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_appears_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "recording"
    path.mkdir()
    with written_beside(path) as partial:
        write_text(partial / "a.txt", "a")
        assert list(path.iterdir()) == []
    assert (path / "a.txt").read_text() == "a"
    assert [p.name for p in tmp_path.iterdir()] == ["recording"]


def test_the_partial_file_keeps_its_suffix(tmp_path: Path) -> None:
    with written_beside(tmp_path / "view.png") as partial:
        assert partial.suffix == ".png"
        assert partial.parent == tmp_path
        partial.touch()


def test_a_folder_with_something_in_it_is_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "kept.txt").touch()
    with (
        pytest.raises(OutputError, match="old: is there already; expected a new name"),
        written_beside(tmp_path / "old"),
    ):
        pytest.fail("the work was begun")
    assert (tmp_path / "old" / "kept.txt").exists()


def test_a_parent_that_is_a_file_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"file/result\.csv: cannot be written"):
        write_text(tmp_path / "file" / "result.csv", "text")


def test_a_block_that_writes_nothing_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="No such file"), written_beside(tmp_path / "a.txt"):
        pass
