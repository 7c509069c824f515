"""The page about a run, and its thumbnails."""

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc.cameras import Equirectangular
from palletloc.cli.app import run
from palletloc.drawing.outline import place_outline, project_line
from palletloc.drawing.overlay import Mark, draw_part, draw_thumbnail, region_of_interest
from palletloc.explained import IN_WORDS
from palletloc.geometry import Image, LevelPose
from palletloc.io.recording import Recording, ShotFile
from palletloc.measurement import Reason
from palletloc.pallet import PalletModel
from palletloc.report.plan_svg import Footprint, plan_svg
from palletloc.shelf import ShelfPlane

CAMERA = Equirectangular(2048, 1024)
CAMERA_FROM_FORKLIFT = RigidTransform.from_translation([0.0, 0.0, -1.8])
GREEN = "#00ff00"


def looking_at(azimuth: float, away: float = 2.5) -> LevelPose:
    """Return a pallet that faces the camera in a direction."""
    return LevelPose(away * np.cos(azimuth), away * np.sin(azimuth), 0.0, azimuth)


@pytest.mark.parametrize("azimuth", [0.0, 1.2, 3.1, np.pi, -3.0])
@pytest.mark.parametrize("width", [120, 480, 1500])
def test_outlines_in_small_and_large_pictures_lie_where_the_camera_sees_them(
    azimuth: float, width: int, t11: PalletModel
) -> None:
    mark = Mark(t11, looking_at(azimuth), GREEN, halo=False)
    blank = np.zeros((1024, 2048, 3), np.uint8)
    region = region_of_interest(CAMERA, CAMERA_FROM_FORKLIFT, [mark], 0.02)
    drawn = draw_part(blank, CAMERA, CAMERA_FROM_FORKLIFT, [mark], region, width)
    scale = width / region.width
    assert drawn.shape == (round(region.height * scale), width, 3)
    curves = [
        curve
        for line in place_outline(t11, looking_at(azimuth))
        for curve in project_line(CAMERA, CAMERA_FROM_FORKLIFT, line)
    ]
    pixels = np.concatenate(curves)
    columns = (pixels[:, 0] - region.left) % 2048
    expected = (np.column_stack([columns, pixels[:, 1] - region.top]) + 0.5) * scale - 0.5
    lit = cv2.distanceTransform(np.where(drawn[..., 1] > 100, 0, 255).astype(np.uint8), cv2.DIST_L2, 5)
    rows = np.clip(np.rint(expected).astype(int), 0, np.array(drawn.shape[1::-1]) - 1)
    assert lit[rows[:, 1], rows[:, 0]].max() <= 2.0
    assert (drawn[..., 0] == 0).all()


def test_the_shot_is_left_alone_and_seams_are_closed(t11: PalletModel) -> None:
    image = np.random.default_rng(0).integers(0, 255, (1024, 2048), dtype=np.uint8)
    before = image.copy()
    small = draw_thumbnail(image, CAMERA, CAMERA_FROM_FORKLIFT, [Mark(t11, looking_at(np.pi), GREEN)], 240)
    assert small.shape[1] == 240
    assert small.ndim == 3
    assert (image == before).all()
    assert (small > 0).mean() > 0.9


def test_every_reason_is_put_into_words_with_what_to_do() -> None:
    assert set(IN_WORDS) == set(Reason)
    assert all(means and remedy for means, remedy in IN_WORDS.values())


def test_the_plan_has_every_pallet_and_shot_inside_and_one_scale(t11: PalletModel) -> None:
    path = [LevelPose(0.5 * i, 0.0, 0.0, 0.0) for i in range(8)]
    places = [LevelPose(1.0, 2.0, 0.0, np.pi / 2), LevelPose(4.0, 2.1, 1.5, 1.4)]
    text = plan_svg(
        path, [Footprint(t11, place.transform()) for place in places], ShelfPlane(1.0, 2.0, -np.pi / 2, (0.0,))
    )
    left, top, width, height = (float(value) for value in re.findall(r'viewBox="(.+?)"', text)[0].split())
    assert text.count("<circle") == 8
    outlines = re.findall(r'class="pallet" d="M(.+?)Z"', text)
    corners = np.array([[point.split() for point in outline.split("L")] for outline in outlines], dtype=float)
    assert corners.shape == (2, 4, 2)
    assert np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1) == pytest.approx(t11.width, abs=2e-3)
    assert (corners >= [left, top]).all()
    assert (corners <= [left + width, top + height]).all()
    assert corners[0, :, 1].max() == pytest.approx(-2.0, abs=1e-3)  # left of the way is up


def images(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "overview").iterdir())


@pytest.fixture
def localized(blank_recording: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    monkeypatch.chdir(blank_recording.parent)
    return lambda *options: run(["localize", "approach", "--out", "out", "--quiet", *options])


def stops_at(number: int) -> Callable[[Recording, ShotFile], Image]:
    read = Recording.image

    def image(recording: Recording, shot: ShotFile) -> Image:
        if shot.file == f"images/{number}.png":
            raise KeyboardInterrupt
        return read(recording, shot)

    return image


def test_each_shot_has_its_thumbnail_and_the_command_that_explains_it(localized: Callable[..., int]) -> None:
    Path("approach/images/2.png").write_bytes(b"")
    assert localized("--method", "horizontal_plane") == 0
    page = Path("out/overview.html").read_text()
    assert images(Path("out")) == ["000000.jpg", "000001.jpg", "000003.jpg"]
    assert re.findall(r'<img src="(.+?)"', page) == [f"overview/{name}" for name in images(Path("out"))]
    commands = re.findall(r"<code>(palletloc explain .+?)</code>", page)
    assert len(commands) == 4
    assert commands[3] == "palletloc explain approach --shot 3 --out out/explain-3 --method horizontal_plane"
    assert "images/2.png: " in page  # why it could not be used
    assert run([*commands[3].split()[1:], "--quiet"]) == 0


def test_a_resumed_run_has_the_page_of_a_whole_one_and_a_second_run_nothing_of_the_first(
    localized: Callable[..., int], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert localized() == 0
    whole = {path: path.read_bytes() for path in Path("out").rglob("*") if path.is_file()}
    with monkeypatch.context() as patch:
        patch.setattr(Recording, "image", stops_at(2))
        assert localized() == 130
    assert "2</b><span>shots<" in Path("out/overview.html").read_text()
    assert localized("--resume") == 0
    assert {path: path.read_bytes() for path in Path("out").rglob("*") if path.is_file()} == whole
    lines = Path("approach/shots.csv").read_text().splitlines()
    Path("approach/shots.csv").write_text("\n".join(lines[:3]) + "\n")
    Path("out/overview/notes.jpg").write_text("mine")
    assert localized() == 0
    assert images(Path("out")) == ["000000.jpg", "000001.jpg", "notes.jpg"]
