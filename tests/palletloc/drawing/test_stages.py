import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Polygon
from scipy.spatial.transform import RigidTransform

from palletloc.candidate import Candidate, Fit, Refusal, last_step, steps_of
from palletloc.choices import Method
from palletloc.config import LocalizerConfig
from palletloc.drawing.canvas import WIDTH_PX, png
from palletloc.drawing.face_figure import face_figure
from palletloc.drawing.paper_figures import horizontal_figure, sweep_figure, vote_stretches
from palletloc.drawing.plan_figure import plan_figure
from palletloc.drawing.shelf_figure import shelf_figure
from palletloc.drawing.stages import Picture, stage_pictures
from palletloc.edge_fit import EdgeFit
from palletloc.explained import name_candidates
from palletloc.face import face_lines
from palletloc.geometry import FloatArray, LevelPose
from palletloc.localizer import Explanation, Localizer, Start
from palletloc.measurement import Reason, Stage
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.paper.horizontal_view import HorizontalView
from palletloc.paper.joint_search import JointSearchConfig
from palletloc.paper.yaw import YawEstimate, YawVote
from palletloc.plane import PALLET_FROM_VERTICAL, place_plane
from palletloc.shelf import ShelfPlane
from palletloc.shot import Shot
from tests.palletloc.drawing.readable import require_readable

SHELF = ShelfPlane(1.0, 2.0, np.radians(-90.0), (0.0,))
Placed = tuple[PalletModel, LevelPose]
COARSE = LocalizerConfig(joint_search=JointSearchConfig(turns=5, depths=5))
"""Spares the joint search most of its views."""


def localizer(models: list[PalletModel], method: Method = Method.HORIZONTAL_PLANE) -> Localizer:
    return Localizer(models, method, COARSE)


@pytest.fixture(scope="module")
def explained(floor_shot: Shot, t11: PalletModel) -> Explanation:
    """Return a shot of a known and an unknown pallet: one is found, other places are given up."""
    return localizer([t11]).explain(replace(floor_shot, time=1.5, file="shot.png"), SHELF)


@pytest.fixture(scope="module")
def pictures(explained: Explanation) -> list[Picture]:
    return list(stage_pictures(explained, SHELF))


@pytest.fixture(scope="module")
def found(explained: Explanation) -> Fit:
    pallet = dict(name_candidates(explained))["P1"]
    assert isinstance(pallet, Fit)
    return pallet


def test_the_pictures_are_numbered_in_the_order_of_the_stages_and_leave_no_figure_open(
    pictures: list[Picture],
) -> None:
    files = [picture.file for picture in pictures]
    assert files == sorted(files, key=lambda file: file[0])
    assert len(set(files)) == len(files)
    of_pallet = ["2-yaw-P1", "3-position-P1", "4-face-P1"]
    assert [picture.stage for picture in pictures] == [
        "1-shelf",
        *of_pallet,
        "5-overlay",
        "5-overlay-whole",
        "6-plan",
    ]
    assert plt.get_fignums() == []


def test_every_picture_can_be_opened_and_shows_something(pictures: list[Picture]) -> None:
    for picture in pictures:
        image = cv2.imdecode(np.frombuffer(picture.content, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None, picture.file
        assert image.std() > 3, picture.file
        assert image.shape[1] <= 1920
        if picture.suffix == ".png":
            assert image.shape[1] == WIDTH_PX


def test_given_starts_have_no_shelf_view_and_are_all_drawn_where_asked(
    floor_shot: Shot, floor_pallets: tuple[Placed, ...], t11: PalletModel
) -> None:
    _, (_, pose) = floor_pallets
    starts = [Start("t11", pose), Start("t11", replace(pose, x=pose.x + 0.55))]  # shifted by one opening
    explained = localizer([t11]).explain_from(floor_shot, starts, (0.0,))
    assert [type(outcome) for outcome in explained.outcomes] == [Fit, Refusal]
    stages = [picture.stage for picture in stage_pictures(explained, None, with_refused=True)]
    assert "1-shelf" not in stages
    assert {"4-face-P1", "4-face-C1"} <= set(stages)


def test_a_shot_without_a_pallet_has_its_pictures(blank_shot: Shot, t11: PalletModel) -> None:
    explained = localizer([t11]).explain(blank_shot, SHELF)
    assert explained.measurements == []
    stages = [picture.stage for picture in stage_pictures(explained, SHELF)]
    assert stages == ["1-shelf", "5-overlay", "5-overlay-whole", "6-plan"]


@pytest.mark.parametrize("method", [Method.PAPER, Method.JOINT_SEARCH])
def test_other_methods_have_their_pictures(method: Method, portrait: Callable[..., Shot], t11: PalletModel) -> None:
    pose = LevelPose(0.4, 2.0, 0.0, np.radians(91))
    shot = portrait(t11, pose)
    explained = localizer([t11], method).explain_from(shot, [Start("t11", pose)], (0.0,))
    stages = {picture.stage for picture in stage_pictures(explained, None)}
    assert {"3-position-P1", "4-face-P1"} <= stages
    assert ("2-yaw-P1" in stages) == (method is Method.PAPER)


def test_figures_are_readable_and_their_titles_tell_what_was_found(
    explained: Explanation, found: Fit, floor_shot: Shot
) -> None:
    shelf = shelf_figure(explained.shelf_views, name_candidates(explained))
    horizontal, estimate = horizontal_figure("P1", found), last_step(found, YawEstimate)
    for figure in (shelf, horizontal, sweep_figure("P1", found), face_figure("P1", found, floor_shot)):
        require_readable(figure)
    (title,) = (text.get_text() for text in shelf.texts)
    assert f"{len(explained.outcomes)} places tried, {len(explained.measurements)} pallets found" in title
    assert estimate is not None
    assert f"yaw {np.degrees(estimate.yaw):.2f}" in " ".join(text.get_text() for text in horizontal.texts)


def test_a_candidate_that_was_not_looked_at_cannot_be_drawn_and_a_face_out_of_view_says_so(
    t11: PalletModel, portrait: Callable[..., Shot]
) -> None:
    candidate = Candidate(t11, LevelPose(1.0, 2.0, 0.0, 1.5))
    refusal = Refusal(candidate, Stage.START, Reason.OUT_OF_RANGE)
    with pytest.raises(ValueError, match="no horizontal view"):
        horizontal_figure("C1", refusal)
    with pytest.raises(ValueError, match="was not searched"):
        sweep_figure("C1", refusal)
    shot = portrait(t11, LevelPose(0.4, 2.0, 0.0, np.radians(91)))
    candidate = Candidate(t11, LevelPose(-3.0, -2.0, 0.0, np.radians(-90)))
    behind = Refusal(candidate, Stage.START, Reason.BEHIND_FACE)
    texts = [text.get_text() for text in face_figure("C1", behind, shot).axes[0].texts]
    assert texts == ["not wholly seen by the camera"]


@pytest.mark.parametrize("step", range(2))
def test_a_voters_line_is_drawn_where_the_camera_sees_the_edge(step: int, found: Fit, floor_shot: Shot) -> None:
    seen = steps_of(found, HorizontalView)[step]
    sharp = replace(found.candidate.model, edge_radius=0.0)
    pose = _pose_of(seen, floor_shot)
    camera_from_face = place_plane(floor_shot.mounting.to_camera, pose, PALLET_FROM_VERTICAL)
    level = [line.whole for line in face_lines(sharp) if line.whole.horizontal]
    assert len(level) == 4
    for edge in level:
        vote = YawVote(edge, 0.0, 0.01, EdgeFit(0.0, 0.0, 0.001, 0.001, 1.0, 9.0), True)
        drawn = vote_stretches(seen, vote, sharp).reshape(-1, 2)
        on_face = np.array([[s.start, s.end] for line in face_lines(sharp) if line.whole == edge for s in line.edges])
        assert _pixels(floor_shot, seen.view.camera_from_plane, drawn) == pytest.approx(
            _pixels(floor_shot, camera_from_face, on_face.reshape(-1, 2)), abs=1e-6
        )


def _pose_of(seen: HorizontalView, shot: Shot) -> LevelPose:
    """Return the pallet's pose that a horizontal view was placed by."""
    matrix = (shot.mounting.to_camera.inv() * seen.view.camera_from_plane).as_matrix()
    into = matrix[:3, 1]
    x, y, z = (float(value) for value in matrix[:3, 3])
    return LevelPose(x, y, z - seen.height, float(np.arctan2(into[1], into[0])))


def _pixels(shot: Shot, camera_from_plane: RigidTransform, points: FloatArray) -> FloatArray:
    in_space = np.column_stack([points, np.zeros(len(points))])
    return shot.camera.project(camera_from_plane.apply(in_space)).pixels


def plan(sigma: float, pose: LevelPose, model: PalletModel, **settings: Any) -> Figure:
    covariance = np.diag([sigma**2, (2 * sigma) ** 2, 1e-6, np.radians(0.5) ** 2])
    mounting = Mounting(RigidTransform.from_translation([0.3, -0.08, 1.85]))
    return plan_figure([("P1", model, pose, covariance)], mounting, settings.get("shelf"))


def drawn_times(figure: Figure) -> float:
    """Return the factor that the figure states for all that is not known."""
    (line,) = (text.get_text() for text in figure.texts if "standard deviations" in text.get_text())
    factor = re.search(r"all drawn (\d+) times as large", line)
    assert factor or "to scale" in line
    return float(factor[1]) if factor else 1.0


@pytest.mark.parametrize("sigma", [0.0005, 0.004, 0.03])
def test_the_ellipses_show_one_and_three_standard_deviations_times_the_stated_factor(
    sigma: float, t11: PalletModel
) -> None:
    figure = plan(sigma, LevelPose(2.0, 1.9, 0.0, 1.5), t11)
    axes, factor = figure.axes[0], drawn_times(figure)
    assert sigma < 0.03 or factor == 1  # what can be seen has its true size
    ellipses = [patch for patch in axes.patches if isinstance(patch, Ellipse)]
    sizes = sorted(sorted([patch.get_width(), patch.get_height()]) for patch in ellipses)
    assert sizes[0] == pytest.approx([2 * sigma * factor, 4 * sigma * factor])
    assert sizes[1] == pytest.approx([6 * sigma * factor, 12 * sigma * factor])
    assert 0.2 < sizes[1][1] < 1.0


def test_one_factor_holds_for_all_ellipses_and_fans_so_that_sizes_can_be_compared(t11: PalletModel) -> None:
    mounting = Mounting(RigidTransform.from_translation([0.3, -0.08, 1.85]))
    placed = []
    for i, sigma in enumerate([0.002, 0.008, 0.02]):
        covariance = np.diag([sigma**2, sigma**2, 1e-6, (0.2 * sigma) ** 2])
        placed.append((f"P{i}", t11, LevelPose(2.0 + 1.5 * i, 1.9, 0.0, np.pi / 2), covariance))
    figure = plan_figure(placed, mounting, None)
    ellipses = [patch.get_width() for patch in figure.axes[0].patches if isinstance(patch, Ellipse)]
    drawn = [2 * count * sigma * drawn_times(figure) for sigma in (0.002, 0.008, 0.02) for count in (1, 3)]
    assert sorted(ellipses) == pytest.approx(sorted(drawn))
    fans = [patch for patch in figure.axes[0].patches if isinstance(patch, Polygon) and len(patch.get_xy()) > 30]
    widths = sorted(float(np.ptp(fan.get_xy()[:, 0])) for fan in fans)
    turns = np.arcsin(np.array(widths) / 2 / 0.9) / drawn_times(figure)
    assert turns == pytest.approx(sorted(count * 0.2 * sigma for sigma in (0.002, 0.008, 0.02) for count in (1, 3)))


def test_names_of_stacked_pallets_do_not_cover_each_other(t11: PalletModel) -> None:
    mounting, covariance = Mounting(RigidTransform.from_translation([0.3, -0.08, 1.85])), np.eye(4) * 1e-5
    poses = [LevelPose(2.0 + 0.1 * i, 1.9, float(i), 1.5) for i in range(3)]
    figure = plan_figure([(f"P{i}", t11, pose, covariance) for i, pose in enumerate(poses)], mounting, None)
    png(figure)
    boxes = [text.get_window_extent() for text in figure.axes[0].texts if text.get_text().startswith("P")]
    assert len(boxes) == 3
    assert not any(box.overlaps(other) for i, box in enumerate(boxes) for other in boxes[:i])


def test_the_map_has_a_row_of_numbers_for_each_pallet(t11: PalletModel) -> None:
    cells = [text.get_text() for text in plan(0.004, LevelPose(2.0, 1.9, 0.5, 1.5), t11).axes[1].texts]
    assert cells.count("0.500") == 2  # the height in metres, and the yaw's sigma in degrees
    assert {"P1", "0.500", "2.000", "1.900", "8.0", "4.0", "85.94"} <= set(cells)


def test_the_pallet_lies_behind_its_front_on_the_map_that_has_one_scale(t11: PalletModel) -> None:
    figure = plan(0.003, LevelPose(2.0, 1.9, 0.0, np.pi / 2), t11, shelf=SHELF)
    corners = next(np.asarray(patch.get_xy()) for patch in figure.axes[0].patches if isinstance(patch, Polygon))
    assert corners.min(axis=0) == pytest.approx([2.0 - t11.width / 2, 1.9])
    assert corners.max(axis=0) == pytest.approx([2.0 + t11.width / 2, 1.9 + t11.depth])
    require_readable(figure)
    axes = plan(0.003, LevelPose(4.0, -1.9, 0.0, -1.5), t11).axes[0]
    x, y = axes.transData.transform([[0.0, 0.0], [1.0, 1.0]]).T
    assert np.diff(x) == pytest.approx(np.diff(y), rel=0.01)
