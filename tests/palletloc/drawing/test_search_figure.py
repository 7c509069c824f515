from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.patches import Ellipse, Rectangle

from palletloc import Candidate, Explanation, Fit, LevelPose, Localizer, PalletModel, Refusal, Shot, Start
from palletloc.candidate import last_step
from palletloc.drawing.canvas import WIDTH_PX, add_axes, new_figure
from palletloc.drawing.face_figure import face_figure
from palletloc.drawing.search_figure import search_figure
from palletloc.drawing.shelf_figure import Label, write_labels
from palletloc.drawing.stages import stage_pictures
from palletloc.explained import EdgeFate, SearchAxes, account_edges
from palletloc.face import EdgeKind
from palletloc.measurement import Reason, Stage
from palletloc.refinement.face_fit import FaceEstimate
from palletloc.refinement.search import Search
from tests.palletloc.drawing.readable import require_readable, some_overlap

POSE = LevelPose(0.4, 2.0, 0.0, np.radians(91))


@pytest.fixture(scope="module")
def shot(portrait: Callable[..., Shot], t11: PalletModel) -> Shot:
    return portrait(t11, POSE)


def explained(shot: Shot, model: PalletModel, *starts: LevelPose) -> Explanation:
    return Localizer([model]).explain_from(shot, [Start(model.name, start) for start in starts], (0.0,))


@pytest.fixture(scope="module")
def near(shot: Shot, t11: PalletModel) -> Fit:
    (found,) = explained(shot, t11, replace(POSE, y=POSE.y + 0.05)).outcomes
    assert isinstance(found, Fit)
    return found


def search_of(fit: Fit) -> Search:
    found = last_step(fit, Search)
    assert found is not None
    return found


def face_of(fit: Fit) -> FaceEstimate:
    assert fit.face is not None
    return fit.face


@pytest.fixture(scope="module")
def far(near: Fit) -> Fit:
    """Return a fit that was looked for coarsely first, and closer around three peaks."""
    found = search_of(near)
    return replace(near, steps=(replace(found, finer=(found,) * 3),))


def test_the_map_shows_every_score_at_its_yaw_and_distance(near: Fit) -> None:
    axes = search_figure("P1", near).axes[0]
    (mesh,) = (each for each in axes.collections if isinstance(each, QuadMesh))
    grid, on = search_of(near).found.grid, SearchAxes.of(search_of(near).patch)
    assert np.asarray(mesh.get_array()).reshape(len(grid.turns), len(grid.ranges)) == pytest.approx(
        search_of(near).found.score
    )
    corners = np.asarray(mesh.get_coordinates())
    middles = (corners[:-1, :-1] + corners[1:, 1:]) / 2
    assert middles[0, :, 0] == pytest.approx(on.ranges(grid.ranges))
    assert middles[:, 0, 1] == pytest.approx(np.degrees(on.yaws(grid.turns)))


def test_the_pose_is_marked_where_it_is_and_the_legend_states_two_standard_deviations(near: Fit, shot: Shot) -> None:
    figure = search_figure("P1", near)
    (mark,) = (line for line in figure.axes[0].lines if str(line.get_label()).startswith("final pose"))
    ((away, yaw),) = np.asarray(mark.get_xydata())
    center = shot.mounting.center
    assert yaw == pytest.approx(91, abs=0.3)
    assert away == pytest.approx(np.hypot(POSE.x - center[0], POSE.y - center[1]), abs=0.01)
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    label = next(text for text in texts if text.startswith("final pose"))
    assert f"{2 * np.degrees(np.sqrt(near.covariance[3, 3])):.2f}\N{DEGREE SIGN}" in label


def test_an_ellipse_that_is_large_enough_is_drawn_at_its_size(near: Fit) -> None:
    wide = replace(near, covariance=np.diag([1e-8, 1e-4, 1e-6, np.radians(1.0) ** 2]))
    ellipses = [patch for patch in search_figure("P1", wide).axes[0].patches if isinstance(patch, Ellipse)]
    assert ellipses
    for ellipse in ellipses:
        assert max(ellipse.get_width(), ellipse.get_height()) == pytest.approx(4.0, rel=0.01)  # degrees


def test_search_figures_are_readable_and_show_both_stages_of_a_coarse_search(near: Fit, far: Fit) -> None:
    unfitted = Refusal(near.candidate, Stage.POSITION, Reason.FEW_EDGES, None, near.steps)
    figures = [search_figure("P1", outcome) for outcome in (far, near, unfitted)]
    for figure in figures:
        assert figure.get_size_inches()[0] * figure.dpi == WIDTH_PX
        require_readable(figure)
    maps = [axes for axes in figures[0].axes if axes.get_ylabel().startswith("yaw")]
    assert len(maps) == 1 + len(search_of(far).finer)


def test_a_refused_candidate_says_why_and_without_a_search_there_is_nothing_to_draw(
    near: Fit, t11: PalletModel
) -> None:
    refused = Refusal(near.candidate, Stage.VERIFICATION, Reason.LOW_CONTRAST, near, near.steps)
    assert "given up in verification: low contrast" in search_figure("C1", refused).texts[0].get_text()
    with pytest.raises(ValueError, match="no hypotheses"):
        search_figure("C1", Refusal(Candidate(t11, POSE), Stage.START, Reason.BEHIND_FACE))


def test_the_face_figure_lists_every_edge(near: Fit, shot: Shot, t11: PalletModel) -> None:
    figure = face_figure("P1", near, shot)
    require_readable(figure)
    cells = {text.get_text() for axes in figure.axes for text in axes.texts}
    for account in account_edges(face_of(near), t11):
        assert str(account.number) in cells
        assert account.name in cells or f"{account.name} (load above)" in cells
        if account.measured is not None:
            assert f"{1000 * account.measured.fit.offset:+.1f}".replace("-", "\N{MINUS SIGN}") in cells


def test_the_face_figure_tells_rejected_and_unseen_edges(near: Fit, shot: Shot, t11: PalletModel) -> None:
    seen = replace(face_of(near).seen, edges=face_of(near).seen.edges[1:])
    weights = np.append(np.ones(len(seen.edges) - 1), 0.0)
    worse = replace(near, face=replace(face_of(near), seen=seen, weights=weights))
    fates = {account.fate for account in account_edges(face_of(worse), t11)}
    assert {EdgeFate.USED, EdgeFate.REJECTED, EdgeFate.NOT_SEEN} <= fates
    figure = face_figure("P1", worse, shot)
    assert {"used", "rejected", "not seen"} <= {text.get_text() for text in figure.legends[0].get_texts()}
    require_readable(figure)


def test_refined_candidates_have_their_pictures_also_where_refused(shot: Shot, t11: PalletModel) -> None:
    found = explained(shot, t11, POSE, replace(POSE, x=POSE.x + 0.55, yaw=POSE.yaw + 0.1))
    stages = {picture.stage for picture in stage_pictures(found, None, with_refused=True)}
    assert {"3-search-P1", "4-face-P1", "6-plan"} <= stages
    assert len([stage for stage in stages if stage.startswith("3-search")]) == 2


def test_what_stands_before_the_face_is_shown(near: Fit, shot: Shot) -> None:
    edges = face_of(near).seen.edges
    right = next(e.edge for e in edges if e.edge.kind is EdgeKind.SIDE and e.edge.outward[0] > 0)
    kept = [i for i, measured in enumerate(edges) if measured.edge != right]
    seen = replace(face_of(near).seen, edges=tuple(edges[i] for i in kept), hidden=((0.3, 0.55),))
    face = replace(face_of(near), seen=seen, weights=face_of(near).weights[kept])
    figure = face_figure("P1", replace(near, face=face), shot)
    keys = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {"hidden", "something stands before the face"} <= keys
    spans = [patch.get_bbox() for patch in figure.axes[1].patches if isinstance(patch, Rectangle)]
    assert [(box.x0, box.x1) for box in spans] == [pytest.approx((0.3, 0.55))]
    require_readable(figure)


def chart() -> Axes:
    axes = add_axes(new_figure(200), 60, 20, 1200, 150)
    axes.set(xlim=(-0.5, 10.5), ylim=(-0.2, 1.2))
    return axes


@settings(max_examples=20, deadline=None)
@given(points=st.lists(st.tuples(st.floats(0, 10), st.floats(0, 1)), min_size=1, max_size=20))
def test_names_cover_neither_each_other_nor_points(points: list[tuple[float, float]]) -> None:
    axes = chart()
    write_labels(axes, [Label(x, y, f"C{i}") for i, (x, y) in enumerate(points)])
    boxes = np.array([text.get_window_extent().extents for text in axes.texts]).reshape(-1, 4)
    low, high = boxes[:, :2], boxes[:, 2:]
    assert not some_overlap(boxes, 0.0)
    centers = axes.transData.transform(points)
    assert not ((centers[:, None] > low) & (centers[:, None] < high)).all(axis=-1).any()


def test_an_important_name_stays_where_there_is_no_room_and_no_point_needs_no_name() -> None:
    axes = chart()
    crowd = [Label(5 + 0.02 * x, 0.1 * y, f"C{x}-{y}") for x in range(-9, 10) for y in range(11)]
    write_labels(axes, [*crowd, Label(5.0, 0.5, "P1", important=True)])
    written = {text.get_text() for text in axes.texts}
    assert "P1" in written
    assert len(written) < len(crowd)
    empty = chart()
    write_labels(empty, [])
    assert list(empty.texts) == []
