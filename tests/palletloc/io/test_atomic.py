import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palletloc.geometry import Image
from palletloc.io.atomic import OutputError, write_bytes, write_text, written_beside
from palletloc.io.image_headers import read_header
from palletloc.io.images import ImageError, read_image, write_image


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
def test_an_exception_leaves_the_earlier_file_alone_and_no_half_folder(
    tmp_path: Path, kind: type[BaseException]
) -> None:
    path = tmp_path / "result.csv"
    write_text(path, "before")

    def interrupted(path: Path, name: str) -> None:
        with written_beside(path) as partial:
            write_text(partial / name, "half of it")
            raise kind

    for place, name in ((path, "."), (tmp_path / "recording", "images/0.txt")):
        with pytest.raises(kind):
            interrupted(place, name)
    assert [p.name for p in tmp_path.iterdir()] == ["result.csv"]
    assert path.read_text() == "before"


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
    refused = pytest.raises(OutputError, match="old: is there already; expected a new name")
    with refused, written_beside(tmp_path / "old"):
        pytest.fail("the work was begun")
    assert (tmp_path / "old" / "kept.txt").exists()


def test_a_parent_that_is_a_file_and_a_block_that_writes_nothing_are_errors(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"file/result\.csv: cannot be written"):
        write_text(tmp_path / "file" / "result.csv", "text")
    with pytest.raises(OutputError, match="No such file"), written_beside(tmp_path / "a.txt"):
        pass


def picture(height: int = 24, width: int = 40) -> Image:
    rows, columns = np.mgrid[:height, :width]
    return np.stack([rows * 9, columns * 6, rows + columns], -1).astype(np.uint8)


def encoded(suffix: str, *options: int) -> bytes:
    content: bytes = cv2.imencode(suffix, picture(), options)[1].tobytes()
    return content


PROGRESSIVE = (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
RESTARTS = (cv2.IMWRITE_JPEG_RST_INTERVAL, 1)
CONTENTS = [
    ("a.jpg", encoded(".jpg")),
    ("a.jpeg", encoded(".jpg", *PROGRESSIVE)),
    ("b.jpg", encoded(".jpg", *RESTARTS)),
    ("a.png", encoded(".png")),
]
KINDS = pytest.mark.parametrize(("name", "content"), CONTENTS, ids=["jpg", "progressive", "restarts", "png"])


def with_segment(jpeg: bytes, marker: int, payload: bytes) -> bytes:
    """Insert a segment after the start marker."""
    return jpeg[:2] + struct.pack(">BBH", 0xFF, marker, len(payload) + 2) + payload + jpeg[2:]


def jpeg_of_size(width: int, height: int) -> bytes:
    content = encoded(".jpg")
    at = content.index(b"\xff\xc0") + 5
    return content[:at] + struct.pack(">HH", height, width) + content[at + 4 :]


def png_of_size(width: int, height: int) -> bytes:
    content = encoded(".png")
    head = b"IHDR" + struct.pack(">II", width, height) + content[24:29]
    return content[:12] + head + struct.pack(">I", zlib.crc32(head)) + content[33:]


@pytest.fixture
def no_decoding(monkeypatch: pytest.MonkeyPatch) -> None:
    def decode(*_: object) -> None:
        pytest.fail("the image was decoded")

    monkeypatch.setattr(cv2, "imdecode", decode)


def test_a_png_comes_back_as_it_was_and_a_jpeg_nearly_so(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", picture())
    assert_array_equal(read_image(tmp_path / "a.png", (40, 24)), picture())
    write_image(tmp_path / "a.JPG", picture(), quality=100)
    assert np.abs(read_image(tmp_path / "a.JPG").astype(int) - picture()).mean() < 3


@KINDS
def test_gray_has_no_channels(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    gray = read_image(tmp_path / name, gray=True)
    assert gray.shape == (24, 40)
    assert np.abs(gray.astype(int) - cv2.cvtColor(picture(), cv2.COLOR_BGR2GRAY)).mean() < 3


@pytest.mark.parametrize("content", [content for _, content in CONTENTS])
def test_every_truncation_is_seen(content: bytes) -> None:
    assert read_header(content) == (40, 24, True)
    for length in range(len(content)):
        header = read_header(content[:length])
        assert header is None or header == (40, 24, False)


@KINDS
@pytest.mark.usefixtures("no_decoding")
def test_a_truncated_file_is_an_error_without_decoding(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    for share in (0.001, 0.1, 0.6, 0.99):
        path.write_bytes(content[: int(len(content) * share) + 1])
        with pytest.raises(ImageError, match=rf"{name}: is (truncated|not a JPEG or PNG image, or is cut off)"):
            read_image(path)


@KINDS
def test_a_tail_of_zeros_is_a_truncation(tmp_path: Path, name: str, content: bytes) -> None:
    half = len(content) * 2 // 3
    (tmp_path / name).write_bytes(content[:half] + bytes(len(content) - half))
    with pytest.raises(ImageError, match="is truncated or damaged"):
        read_image(tmp_path / name)


@KINDS
def test_bytes_after_the_end_do_not_matter(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content + b"\0\0trailer of the camera")
    assert read_image(tmp_path / name).shape == (24, 40, 3)


def test_the_end_of_an_embedded_thumbnail_is_not_the_end() -> None:
    content = with_segment(encoded(".jpg"), 0xE1, b"Exif\0\0" + encoded(".jpg"))
    assert read_header(content) == (40, 24, True)
    assert read_header(content[:-1]) == (40, 24, False)


def test_a_flipped_bit_in_a_png_is_seen(tmp_path: Path) -> None:
    content = bytearray(encoded(".png"))
    content[len(content) // 2] ^= 1
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(ImageError, match="is truncated or damaged"):
        read_image(tmp_path / "a.png")


def test_the_orientation_in_the_file_is_ignored(tmp_path: Path) -> None:
    turned = struct.pack(">2sHIHHHIHHI", b"MM", 42, 8, 1, 0x0112, 3, 1, 6, 0, 0)
    path = tmp_path / "a.jpg"
    path.write_bytes(with_segment(encoded(".jpg"), 0xE1, b"Exif\0\0" + turned))
    assert np.asarray(cv2.imread(str(path))).shape == (40, 24, 3), "the file asks for no rotation"
    assert read_image(path, (40, 24)).shape == (24, 40, 3)
    assert read_image(path, (40, 24), gray=True).shape == (24, 40)


LIMIT = "px; expected at most 16384 px a side"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (jpeg_of_size(30_000, 15_000), f"is 30000 x 15000 {LIMIT}"),
        (jpeg_of_size(64, 30_000), f"is 64 x 30000 {LIMIT}"),
        (png_of_size(30_000, 15_000), f"is 30000 x 15000 {LIMIT}"),
        (png_of_size(16_384, 16_384), f"is 16384 x 16384 {LIMIT}"),
        (png_of_size(0, 24), f"is 0 x 24 {LIMIT}"),
        (b"", "is empty"),
        (b"time_s,file\n", "is not a JPEG or PNG image"),
        (b"GIF89a" + bytes(100), "is not a JPEG or PNG image"),
        (b"\x89PNG\r\n\x1a\n" + bytes(100), "is not a JPEG or PNG image"),
    ],
)
@pytest.mark.usefixtures("no_decoding")
def test_a_huge_or_empty_image_and_what_is_none_are_refused_without_decoding(
    tmp_path: Path, content: bytes, said: str
) -> None:
    (tmp_path / "a.jpg").write_bytes(content)
    with pytest.raises(ImageError, match=rf"a\.jpg: {said}"):
        read_image(tmp_path / "a.jpg")


@KINDS
@pytest.mark.usefixtures("no_decoding")
def test_another_size_than_the_cameras_names_both(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ImageError, match=rf"{name}: is 40 x 24 px, the camera is 3840 x 1920 px"):
        read_image(tmp_path / name, (3840, 1920))


def test_an_image_that_the_decoder_refuses_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.jpg").write_bytes(encoded(".jpg"))
    monkeypatch.setattr(cv2, "imdecode", lambda *_: None)
    with pytest.raises(ImageError, match=r"a\.jpg: is damaged"):
        read_image(tmp_path / "a.jpg")


def test_a_missing_file_and_a_folder_are_errors(tmp_path: Path) -> None:
    for path, said in ((tmp_path / "none.jpg", r"none\.jpg: no such file"), (tmp_path, "is not a file")):
        with pytest.raises(ImageError, match=said):
            read_image(path)


def test_an_image_is_written_as_its_name_says_or_not_at_all(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"\.jpg, \.jpeg or \.png"):
        write_image(tmp_path / "a.bmp", picture())
    (tmp_path / "file").touch()
    with pytest.raises(OutputError):
        write_image(tmp_path / "file" / "a.png", picture())
