import io
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.spatial.transform import RigidTransform

from benchmarks.command import run
from benchmarks.method_figure import method_figure
from palletloc import LevelPose, PalletLocError, PalletMeasurement, Recording, ShelfPlane, load_library
from palletloc.cameras import Equirectangular
from palletloc.drawing.canvas import png, small_png
from palletloc.geometry import level_pose
from palletloc.io.recording import ShotFile
from palletloc.io.truth import TruePallet, Truth
from palletloc.measurement import YawSource
from palletloc.trajectory import Trajectory

TIMES = (0.0, 1.0, 2.0)
FORKLIFT = Trajectory(np.array(TIMES), np.array([1.0, 1.3, 1.6]), np.full(3, 0.2), np.full(3, 0.3))
LOW = TruePallet("A", "t11", LevelPose(3.0, 2.5, 0.1, 1.7))
HIGH = TruePallet("B", "t11", LevelPose(3.0, 2.5, 1.5, 1.7))
TRUTH = Truth(FORKLIFT, (LOW, HIGH))


@pytest.fixture
def recording() -> Recording:
    mounting = RigidTransform.from_translation([0.3, 0.0, 1.8])
    shots = tuple(ShotFile(time, f"{time}.jpg") for time in TIMES)
    return Recording(
        Path("aisle"),
        Equirectangular(64, 32),
        mounting,
        ShelfPlane(3.0, 2.0, -1.5),
        (load_library()["t11"],),
        shots,
        FORKLIFT,
    )


def measured(time: float, depth: float, yaw: float, pallet: TruePallet = LOW) -> PalletMeasurement:
    true = FORKLIFT.pose_at(time).transform().inv() * pallet.world_from_pallet.transform()
    moved = level_pose(true * LevelPose(depth, 0.0, 0.0, yaw).transform())
    return PalletMeasurement(time, "t11", moved, np.eye(4) * 1e-4, 0.9, YawSource.BOTTOM, f"{time}.jpg")


def drawn(figure: Figure, color: str) -> list[list[np.ndarray]]:
    """Return the data of the lines of one colour in each chart that is no table."""
    charts = [axes for axes in figure.axes if axes.get_yscale() == "log"]
    return [[np.asarray(line.get_xydata()) for line in axes.lines if line.get_color() == color] for axes in charts]


def test_errors_stand_at_their_shots_pallets_far_below_apart(recording: Recording) -> None:
    runs = {"a": [measured(0.0, 0.02, -0.01), measured(2.0, -0.05, 0.03)], "b": [measured(1.0, 0.001, 0.002, HIGH)]}
    figure = method_figure(recording, TRUTH, runs)
    charts = drawn(figure, "#0072b2")  # yaw and depth of pallets far below, then of the others
    assert [len(chart) for chart in charts] == [2, 2, 0, 0]
    points, line = charts[0]
    assert points[:, 1] == pytest.approx(np.degrees([0.01, 0.03]))
    assert np.round(points[:, 0]) == pytest.approx([0, 2])
    assert line[:, 1] == pytest.approx(points[:, 1])
    assert charts[1][0][:, 1] == pytest.approx([20.0, 50.0])
    assert drawn(figure, "#d55e00")[3][0][:, 1] == pytest.approx([1.0])


def test_the_table_says_what_was_found_and_how_well_and_no_text_covers_another(recording: Recording) -> None:
    runs = {"good": [measured(time, 0.002, 0.001) for time in TIMES], "blind": []}
    cells = [text.get_text() for text in method_figure(recording, TRUTH, runs).axes[2].texts]
    assert cells.count("3 of 3") == 1
    assert cells.count("0 of 3") == 1
    assert f"{np.degrees(0.001):.2f} / {np.degrees(0.001):.2f}" in cells
    assert "2.0 / 2.0" in cells
    runs = {
        name: [measured(0.0, 0.0874, 0.5, pallet) for pallet in (LOW, HIGH)] for name in ("horizontal_plane", "other")
    }
    figure = method_figure(recording, TRUTH, runs)
    png(figure)  # places the texts
    tables = [axes for axes in figure.axes if axes.get_yscale() != "log"]
    assert len(tables) == 2
    for axes in tables:
        boxes = [text.get_window_extent() for text in axes.texts if text.get_text()]
        assert not any(box.overlaps(other) for i, box in enumerate(boxes) for other in boxes[:i])


def test_one_height_only_fills_the_page_and_an_error_of_nothing_is_drawn_at_the_border(recording: Recording) -> None:
    figure = method_figure(recording, Truth(FORKLIFT, (LOW,)), {"a": [measured(0.0, 0.01, 0.01)]})
    assert sum(axes.get_yscale() == "log" for axes in figure.axes) == 2
    figure = method_figure(recording, TRUTH, {"a": [measured(0.0, 0.0, 0.0)]})
    assert all(np.isfinite(line).all() and (line[:, 1] > 0).all() for line in drawn(figure, "#0072b2")[0])


def test_the_page_names_the_recording_and_is_small(recording: Recording) -> None:
    runs = {name: [measured(time, 0.01, 0.01, pallet) for time in TIMES for pallet in (LOW, HIGH)] for name in "abcd"}
    figure = method_figure(recording, TRUTH, runs)
    assert figure.texts[0].get_text().startswith("aisle:")
    content = small_png(figure)
    assert len(content) < 150_000
    small, whole = (cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) for data in (content, png(figure)))
    assert small is not None
    assert whole is not None
    assert np.abs(small.astype(int) - whole).mean() < 2
    assert io.BytesIO(content).read(4) == b"\x89PNG"


def test_no_method_and_a_foreign_truth_are_refused(recording: Recording) -> None:
    with pytest.raises(ValueError, match="no method"):
        method_figure(recording, TRUTH, {})
    foreign = Truth(FORKLIFT, (TruePallet("A", "unknown", LOW.world_from_pallet),))
    with pytest.raises(PalletLocError, match="unknown"):
        method_figure(recording, foreign, {"a": []})
    short = Trajectory(np.array(TIMES[:2]), np.array([1.0, 1.3]), np.full(2, 0.2), np.full(2, 0.3))
    with pytest.raises(PalletLocError, match="no truth for the shot at 2 s"):
        method_figure(recording, Truth(short, (LOW,)), {"a": []})


def test_a_figure_belongs_to_the_accuracy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ending:
        run(["--figure", str(tmp_path)])
    assert ending.value.code == 2
    assert "--figure needs --accuracy" in capsys.readouterr().err
