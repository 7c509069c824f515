from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Rectangle

from palletloc.candidate import Candidate, Fit, Refusal
from palletloc.choices import Method
from palletloc.drawing.canvas import WIDTH_PX, png
from palletloc.drawing.face_figure import face_figure
from palletloc.drawing.search_figure import search_figure
from palletloc.drawing.stages import stage_pictures
from palletloc.explained import EdgeFate, SearchAxes, account_edges
from palletloc.face import EdgeKind
from palletloc.geometry import LevelPose
from palletloc.localizer import Explanation, Localizer, Start
from palletloc.measurement import Reason, Stage
from palletloc.pallet import PalletModel
from palletloc.shot import Shot

POSE = LevelPose(0.4, 2.0, 0.0, np.radians(91))


@pytest.fixture(scope="module")
def shot(portrait: Callable[..., Shot], t11: PalletModel) -> Shot:
    return portrait(t11, POSE)


def explained(shot: Shot, model: PalletModel, *starts: LevelPose) -> Explanation:
    localizer = Localizer([model], Method.REFINED)
    return localizer.explain_from(shot, [Start(model.name, start) for start in starts], (0.0,))


@pytest.fixture(scope="module")
def near(shot: Shot, t11: PalletModel) -> Candidate:
    return explained(shot, t11, replace(POSE, y=POSE.y + 0.05)).candidates[0]


@pytest.fixture(scope="module")
def far(near: Candidate) -> Candidate:
    """Return a candidate that was looked for coarsely first, and closer around three peaks."""
    assert near.search is not None
    finer = tuple(replace(near.search) for _ in range(3))
    return replace(near, search=replace(near.search, finer=finer))


def require_readable(figure: Figure) -> None:
    """Check that texts beside the axes and the axes' labels lie on the page and cover no other."""
    png(figure)  # places the texts
    width, height = figure.get_size_inches() * figure.dpi
    outside = [text for text in figure.texts if text.get_text()]
    outside += [label for axes in figure.axes for label in (axes.xaxis.label, axes.yaxis.label) if label.get_text()]
    outside += [text for legend in figure.legends for text in legend.get_texts()]
    boxes = np.array([text.get_window_extent().extents for text in outside])
    assert (boxes[:, :2] >= 0).all()
    assert (boxes[:, 2] <= width).all()
    assert (boxes[:, 3] <= height).all()
    low, high = boxes[:, :2], boxes[:, 2:]
    shared = np.minimum(high[:, None], high) - np.maximum(low[:, None], low)
    assert not (np.all(shared > 1.0, axis=-1) & ~np.eye(len(boxes), dtype=bool)).any()


def label_of(figure: Figure, start: str) -> str:
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    return next(text for text in texts if text.startswith(start))


def test_the_map_shows_every_score_at_its_yaw_and_distance(near: Candidate) -> None:
    assert near.search is not None
    axes = search_figure("P1", near).axes[0]
    (mesh,) = (one for one in axes.collections if isinstance(one, QuadMesh))
    grid, on = near.search.found.grid, SearchAxes.of(near.search.patch)
    assert np.asarray(mesh.get_array()).reshape(len(grid.turns), len(grid.ranges)) == pytest.approx(
        near.search.found.score
    )
    corners = np.asarray(mesh.get_coordinates())
    middles = (corners[:-1, :-1] + corners[1:, 1:]) / 2
    assert middles[0, :, 0] == pytest.approx(on.ranges(grid.ranges))
    assert middles[:, 0, 1] == pytest.approx(np.degrees(on.yaws(grid.turns)))


def test_the_pose_is_marked_where_it_is(near: Candidate, shot: Shot) -> None:
    axes = search_figure("P1", near).axes[0]
    (mark,) = (line for line in axes.lines if str(line.get_label()).startswith("final pose"))
    ((away, yaw),) = np.asarray(mark.get_xydata())
    center = shot.mounting.center
    assert yaw == pytest.approx(91, abs=0.3)
    assert away == pytest.approx(np.hypot(POSE.x - center[0], POSE.y - center[1]), abs=0.01)


def test_the_legend_states_two_standard_deviations(near: Candidate) -> None:
    assert near.covariance is not None
    sigma = np.degrees(np.sqrt(near.covariance[3, 3]))
    assert f"{2 * sigma:.2f}\N{DEGREE SIGN}" in label_of(search_figure("P1", near), "final pose")


def test_an_ellipse_that_is_large_enough_is_drawn_at_its_size(near: Candidate) -> None:
    yaw_sigma = np.radians(1.0)
    wide = replace(near, covariance=np.diag([1e-8, 1e-4, 1e-6, yaw_sigma**2]))
    patches = [one for one in search_figure("P1", wide).axes[0].patches if isinstance(one, Ellipse)]
    assert patches
    for one in patches:
        assert max(one.get_width(), one.get_height()) == pytest.approx(4.0, rel=0.01)  # degrees


def test_both_stages_of_a_coarse_search_are_shown(far: Candidate) -> None:
    assert far.search is not None
    maps = [axes for axes in search_figure("P1", far).axes if axes.get_ylabel().startswith("yaw")]
    assert len(maps) == 1 + len(far.search.finer)


def test_search_figures_are_readable(near: Candidate, far: Candidate) -> None:
    refused = replace(near, pose=None, covariance=None, refusal=(Stage.POSITION, Reason.FEW_EDGES))
    for one in (near, far, refused):
        figure = search_figure("P1", one)
        assert figure.get_size_inches()[0] * figure.dpi == WIDTH_PX
        require_readable(figure)


def test_a_refused_candidate_says_why(near: Candidate) -> None:
    refused = replace(near, refusal=(Stage.VERIFICATION, Reason.LOW_CONTRAST))
    assert "given up in verification: low contrast" in search_figure("C1", refused).texts[0].get_text()


def test_without_a_search_there_is_nothing_to_draw(t11: PalletModel) -> None:
    with pytest.raises(ValueError, match="no hypotheses"):
        search_figure("C1", Candidate(t11, POSE, None))


def test_the_face_figure_lists_every_edge(near: Candidate, shot: Shot, t11: PalletModel) -> None:
    assert near.face is not None
    figure = face_figure("P1", near, shot)
    require_readable(figure)
    cells = {text.get_text() for axes in figure.axes for text in axes.texts}
    for one in account_edges(near.face, t11):
        assert str(one.number) in cells
        assert one.name in cells or f"{one.name} (load above)" in cells
        if one.measured is not None:
            assert f"{1000 * one.measured.fit.offset:+.1f}".replace("-", "\N{MINUS SIGN}") in cells


def test_the_face_figure_tells_rejected_and_unseen_edges(near: Candidate, shot: Shot, t11: PalletModel) -> None:
    assert near.face is not None
    seen = replace(near.face.seen, edges=near.face.seen.edges[1:])
    weights = np.append(np.ones(len(seen.edges) - 1), 0.0)
    worse = replace(near, face=replace(near.face, seen=seen, weights=weights))
    assert worse.face is not None
    fates = {one.fate for one in account_edges(worse.face, t11)}
    assert {EdgeFate.USED, EdgeFate.REJECTED, EdgeFate.NOT_SEEN} <= fates
    figure = face_figure("P1", worse, shot)
    assert {"used", "rejected", "not seen"} <= {text.get_text() for text in figure.legends[0].get_texts()}
    require_readable(figure)


def test_refined_candidates_have_their_pictures_also_where_refused(shot: Shot, t11: PalletModel) -> None:
    found = explained(shot, t11, POSE, replace(POSE, x=POSE.x + 0.55, yaw=POSE.yaw + 0.1))
    stages = {one.stage for one in stage_pictures(found, shot, None, with_refused=True)}
    assert {"3-search-P1", "4-face-P1", "6-plan"} <= stages
    assert len([stage for stage in stages if stage.startswith("3-search")]) == 2


def test_what_stands_before_the_face_is_shown(near: Candidate, shot: Shot) -> None:
    assert near.face is not None
    edges = near.face.seen.edges
    right = next(one.edge for one in edges if one.edge.kind is EdgeKind.SIDE and one.edge.outward[0] > 0)
    kept = [i for i, one in enumerate(edges) if one.edge != right]
    seen = replace(near.face.seen, edges=tuple(edges[i] for i in kept), hidden=((0.3, 0.55),))
    face = replace(near.face, seen=seen, weights=near.face.weights[kept])
    figure = face_figure("P1", replace(near, face=face), shot)
    keys = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {"hidden", "something stands before the face"} <= keys
    spans = [patch.get_bbox() for patch in figure.axes[1].patches if isinstance(patch, Rectangle)]
    assert [(box.x0, box.x1) for box in spans] == [pytest.approx((0.3, 0.55))]
    require_readable(figure)
