"""Images that are damaged inside, that are parts of panoramas, and the kinds of files that are read."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import pytest

from palletloc.geometry import Image
from palletloc.io.image_headers import read_header
from palletloc.io.images import ImageError, read_image
from palletloc.io.panorama import panorama_fault
from palletloc.io.recording import read_recording


def scene(width: int = 320, height: int = 160) -> Image:
    """Return a picture with detail everywhere, so that every part of its file matters."""
    rng = np.random.default_rng(3)
    rough = rng.integers(0, 256, (height // 8, width // 8, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(rough, (width, height), interpolation=cv2.INTER_CUBIC), np.uint8)


def encoded(kind: str, *options: int) -> bytes:
    return cv2.imencode(kind, scene(), list(options))[1].tobytes()


JPEG = encoded(".jpg", cv2.IMWRITE_JPEG_QUALITY, 90)
RESTARTS = encoded(".jpg", cv2.IMWRITE_JPEG_RST_INTERVAL, 4)
PROGRESSIVE = encoded(".jpg", cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
JPEGS = pytest.mark.parametrize("content", [JPEG, RESTARTS, PROGRESSIVE], ids=["plain", "restarts", "progressive"])


def cut(content: bytes, share: float) -> bytes:
    """Cut the data short and end them, as cameras and recorders do."""
    return content[: int(len(content) * share)] + b"\xff\xd9"


def without_a_part(content: bytes, share: float) -> bytes:
    at = int(len(content) * share)
    return content[:at] + content[at + 700 :]


def zeroed(content: bytes, share: float) -> bytes:
    at = int(len(content) * share)
    return content[:at] + bytes(700) + content[at + 700 :]


@JPEGS
@pytest.mark.parametrize("damage", [cut, without_a_part, zeroed])
@pytest.mark.parametrize("share", [0.4, 0.6, 0.9])
def test_a_jpeg_with_damage_inside_is_refused_and_the_decoder_says_nothing(
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    content: bytes,
    damage: Callable[[bytes, float], bytes],
    share: float,
) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(damage(content, share))
    with pytest.raises(ImageError, match=r"a\.jpg: is (truncated or )?damaged"):
        read_image(path)
    with pytest.raises(ImageError, match=r"a\.jpg: is (truncated or )?damaged"):
        read_image(path, gray=True)
    assert capfd.readouterr() == ("", "")


@JPEGS
def test_a_sound_jpeg_is_what_opencv_decodes(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.jpg").write_bytes(content)
    expected = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(read_image(tmp_path / "a.jpg", (320, 160)), expected)


def test_what_others_write_to_standard_error_meanwhile_arrives(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.jpg").write_bytes(JPEG)

    def decode(*_: Any) -> Image:
        os.write(2, b"a line of another thread\nCorrupt JPEG data: bad Huffman code\n")
        return scene()

    monkeypatch.setattr(cv2, "imdecode", decode)
    with pytest.raises(ImageError, match=r"is damaged, .*\(Corrupt JPEG data: bad Huffman code\)"):
        read_image(tmp_path / "a.jpg")
    assert capfd.readouterr().err == "a line of another thread\n"


def test_a_process_without_standard_error_reads_images(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(JPEG)
    program = (
        "import os, sys; from pathlib import Path; from palletloc.io.images import read_image; os.close(2)\n"
        "print(read_image(Path(sys.argv[1])).shape)\n"
        "try: os.fstat(2)\nexcept OSError: print('closed')"
    )
    root = Path(__file__).resolve().parents[3]
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)], cwd=root, capture_output=True, text=True, check=True
    )
    assert done.stdout == "(160, 320, 3)\nclosed\n"


def test_no_file_descriptor_is_lost(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(JPEG)
    open_ones = Path("/proc/self/fd")
    if not open_ones.is_dir():
        pytest.skip("only Linux lists them")
    before = len(list(open_ones.iterdir()))
    for _ in range(20):
        read_image(tmp_path / "a.jpg")
    assert len(list(open_ones.iterdir())) == before


KINDS = {
    "lossy.webp": encoded(".webp", cv2.IMWRITE_WEBP_QUALITY, 80),
    "lossless.webp": encoded(".webp", cv2.IMWRITE_WEBP_QUALITY, 101),
    "a.tiff": encoded(".tiff"),
    "plain.tiff": encoded(".tiff", cv2.IMWRITE_TIFF_COMPRESSION, 1),
    "a.bmp": encoded(".bmp"),
    "a.jp2": encoded(".jp2"),
}


@pytest.mark.parametrize("name", KINDS)
def test_other_kinds_are_read_whatever_their_name_is(tmp_path: Path, name: str) -> None:
    (tmp_path / "image.jpg").write_bytes(KINDS[name])
    assert read_header(KINDS[name]) == (320, 160, True)
    image = read_image(tmp_path / "image.jpg", (320, 160))
    assert np.abs(image.astype(int) - scene()).mean() < 8


@pytest.mark.parametrize("name", KINDS)
def test_every_truncation_of_other_kinds_is_reported(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], name: str
) -> None:
    content = KINDS[name]
    for share in (0.001, 0.02, 0.1, 0.5, 0.9, 0.999):
        (tmp_path / name).write_bytes(content[: int(len(content) * share) + 1])
        with pytest.raises(ImageError, match=rf"{name}: is (truncated|damaged|not a JPEG or PNG image, or is cut)"):
            read_image(tmp_path / name, (320, 160))
    assert capfd.readouterr() == ("", "")


def tiff_of(width: int, height: int, offset: int, size: int, order: str = "II") -> bytes:
    """Return a gray TIFF file whose directory stands before its one strip: TIFF 6.0, page 13."""
    little: Literal["little", "big"] = "little" if order == "II" else "big"
    tags = ((256, width), (257, height), (258, 8), (259, 1), (262, 1), (273, offset), (278, height), (279, size))
    entries = b"".join(
        tag.to_bytes(2, little) + (4).to_bytes(2, little) + (1).to_bytes(4, little) + value.to_bytes(4, little)
        for tag, value in tags
    )
    head = order.encode() + (42).to_bytes(2, little) + (8).to_bytes(4, little)
    return head + len(tags).to_bytes(2, little) + entries + bytes(4)


@pytest.mark.parametrize("order", ["II", "MM"])
def test_a_tiff_file_ends_where_its_last_strip_does(order: str) -> None:
    head = tiff_of(6, 4, 110, 24, order)
    assert len(head) == 110
    assert read_header(head + bytes(24)) == (6, 4, True)
    assert read_header(head + bytes(23)) == (6, 4, False)


BOMBS = {
    "tiff": tiff_of(60_000, 60_000, 110, 4) + bytes(4),
    "bmp": b"BM" + bytes(8) + (54).to_bytes(4, "little") + (40).to_bytes(4, "little")
    + (60_000).to_bytes(4, "little") * 2 + b"\1\0\x18\0" + bytes(24),
    "webp": b"RIFF\x16\0\0\0WEBPVP8X\x0a\0\0\0" + bytes(4) + b"\xff\xff\0" * 2,
    "jp2": b"\xff\x4f\xff\x51\0\x29\0\0" + (60_000).to_bytes(4, "big") * 2 + bytes(32) + b"\xff\xd9",
}  # fmt: skip


@pytest.mark.parametrize("kind", BOMBS)
def test_a_huge_image_of_any_kind_is_refused_without_decoding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("it was decoded"))
    (tmp_path / "a").write_bytes(BOMBS[kind])
    with pytest.raises(ImageError, match=r"a: is 6\d{4} x 6\d{4} px; expected at most 16384 px a side"):
        read_image(tmp_path / "a")


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (b"GIF89a" + bytes(9), "a GIF image"),
        (b"\0\0\0\x18ftypheic" + bytes(9), "a HEIF or AVIF image"),
        (b"\0\0\0\x18ftypmp42" + bytes(9), "a video"),
        (b"<!DOCTYPE html>", "a web page or XML"),
        (b"%PDF-1.7", "a PDF document"),
        (b"II*\0\x10\0\0\0CR\2\0", "a raw photograph"),
    ],
)
def test_what_is_not_read_is_named(tmp_path: Path, content: bytes, kind: str) -> None:
    (tmp_path / "a.jpg").write_bytes(content)
    with pytest.raises(ImageError, match=f"is not a JPEG or PNG image but {kind}; WebP, TIFF, BMP and JPEG 2000"):
        read_image(tmp_path / "a.jpg")


def xmp(**values: object) -> bytes:
    """Return the metadata of a panorama as attributes: https://developers.google.com/streetview/spherical-metadata."""
    said = " ".join(f'GPano:{key}="{value}"' for key, value in values.items())
    return f'<rdf:Description xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" {said}/>'.encode()


def elements(**values: object) -> bytes:
    """Return the same as elements, with another prefix."""
    said = "".join(f"<p:{key}>{value}</p:{key}>" for key, value in values.items())
    return f'<rdf:Description xmlns:p="http://ns.google.com/photos/1.0/panorama/">{said}</rdf:Description>'.encode()


def sizes(whole: tuple[int, int], part: tuple[int, int], left: int = 0, top: int = 0) -> dict[str, int]:
    return {
        "FullPanoWidthPixels": whole[0], "FullPanoHeightPixels": whole[1],
        "CroppedAreaImageWidthPixels": part[0], "CroppedAreaImageHeightPixels": part[1],
        "CroppedAreaLeftPixels": left, "CroppedAreaTopPixels": top,
    }  # fmt: skip


@pytest.mark.parametrize("form", [xmp, elements])
def test_a_part_of_a_panorama_says_so(form: Callable[..., bytes]) -> None:
    fault = panorama_fault(form(ProjectionType="equirectangular", **sizes((4096, 2048), (3840, 1920), 128, 64)))
    assert fault is not None
    assert "3840 x 1920 px of a panorama of 4096 x 2048 px, 337.5 x 168.8 degrees" in fault
    assert "128 px on its left and 64 px above" in fault
    assert panorama_fault(form(ProjectionType="equirectangular", **sizes((4096, 2048), (4096, 2048)))) is None
    assert panorama_fault(form(ProjectionType="equirectangular")) is None
    other = form(ProjectionType="cylindrical")
    assert "projection is 'cylindrical'" in (panorama_fault(other) or "")
    assert panorama_fault(other, any_projection=True) is None
    assert panorama_fault(b"nothing of it") is None


@pytest.mark.parametrize("value", ["", "-5", "1e400", "9" * 30, "nan"])
def test_nonsense_in_metadata_is_no_fault(value: str) -> None:
    assert panorama_fault(xmp(FullPanoWidthPixels=value, CroppedAreaImageWidthPixels=value)) is None


def test_a_recording_refuses_a_part_of_a_panorama(folder: Path) -> None:
    recording = read_recording(folder)
    shot = recording.shots[0]
    path = folder / shot.file
    path.write_bytes(path.read_bytes() + xmp(**sizes((72, 36), (64, 32))))
    with pytest.raises(ImageError, match=r"0\.png: says that it is cropped: 64 x 32 px of a panorama of 72 x 36 px"):
        recording.image(shot)


@pytest.mark.parametrize(("case", "said"), [("jpeg-cut-with-end-marker", "is damaged"), ("gpano-crop", "is cropped")])
def test_the_faults_that_were_found_are_reported(tmp_path: Path, shared_data: Path, case: str, said: str) -> None:
    make = shared_data / "faults" / case / "make.py"
    root = Path(__file__).resolve().parents[3]
    subprocess.run(
        [sys.executable, str(make), str(tmp_path / "rec")], check=True, env={**os.environ, "PYTHONPATH": str(root)}
    )
    recording = read_recording(tmp_path / "rec")
    with pytest.raises(ImageError, match=rf"000012\.jpg: .*{said}"):
        recording.image(recording.shots[0])
