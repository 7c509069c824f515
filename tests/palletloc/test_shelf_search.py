from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc.matching import edge_energy
from palletloc.pallet import PalletModel
from palletloc.plane import PlaneGrid, PlaneView
from palletloc.shelf_search import Sites, Steps, first_steps, refine, search, spaced
from palletloc.shelf_view import DetectionConfig, ShelfView
from palletloc.template import FacePlacement, TemplatePiece, face_template, match_template

CONFIG = DetectionConfig()
RESOLUTION, DISTANCE, HEIGHT = 0.012, 2.1, 1.7
GRID = PlaneGrid.spanning(-1.8, 2.6, -0.7, 0.8, RESOLUTION)
CAMERA = np.array([0.0, HEIGHT, DISTANCE])
WINDOW = (33, 17)
Draw = Callable[..., PlaneView]
Seen = tuple[ShelfView, list[TemplatePiece], Steps]


@pytest.fixture
def shown(epal: PalletModel, draw_face: Draw) -> Callable[..., Seen]:
    """Return a function that draws a face on the shelf: its place, depth behind the plane, yaw and height."""

    def drawn(place: float, depth: float, yaw: float = 0.0, height: float = 0.0, known: bool = True) -> Seen:
        view = draw_face(epal, GRID, CAMERA, (place, height), 1 + depth / DISTANCE, yaw)
        level = height if known else None
        seen = ShelfView(
            RigidTransform.identity(), 0.0, HEIGHT, DISTANCE, (-0.8, 1.4), 0.3, np.radians(1.0), level, view
        )
        config = replace(CONFIG, heights=(-0.05, 0.3))
        return (
            seen,
            face_template(epal, edge_energy(view.image, WINDOW), RESOLUTION),
            first_steps(seen, epal, config),
        )

    return drawn


def best(sites: Sites) -> tuple[float, ...]:
    chosen = sites.chosen(np.array([sites.score.argmax()]))
    return tuple(float(values[0]) for values in chosen)


@pytest.mark.parametrize(
    ("place", "depth", "yaw"), [(0.0, 0.0, 0.0), (0.73, 0.11, 0.05), (-0.51, -0.09, -0.06), (1.2, 0.2, 0.07)]
)
@pytest.mark.parametrize("known", [True, False])
def test_a_face_is_found_where_it_stands(
    place: float, depth: float, yaw: float, known: bool, shown: Callable[..., Seen]
) -> None:
    seen, template, steps = shown(place, depth, yaw, 0.06, known)
    sites = refine(seen, template, steps, search(seen, template, steps, CONFIG), 1.0, CONFIG)
    found = best(sites)
    assert found[0] == pytest.approx(place, abs=0.03 if known else 0.06)
    assert found[1] == pytest.approx(depth, abs=0.03 if known else 0.10)
    assert found[2] == pytest.approx(yaw, abs=0.03)
    assert found[3] == pytest.approx(0.06, abs=1e-9 if known else 0.06)
    assert found[4] > 0.7


def test_the_first_pass_scores_as_the_template_is_matched(shown: Callable[..., Seen]) -> None:
    seen, template, steps = shown(0.4, 0.05)
    sites = search(seen, template, steps, replace(CONFIG, min_score=-1.0))
    placement = FacePlacement(
        1 + sites.depth[:, None] / DISTANCE, np.zeros((len(sites.place), 1)), sites.height[:, None]
    )
    score = match_template(template, GRID, CAMERA, placement, np.zeros(1), sites.place[:, None])[:, 0]
    # the first pass rounds the pieces' places to pixels, and takes off something for the depth
    inside = score > 0.5
    assert inside.any()
    np.testing.assert_allclose(sites.score[inside], score[inside], atol=0.1)
    assert np.abs(sites.score - score).mean() < 0.06


def test_steps_are_as_fine_as_the_view_tolerates(shown: Callable[..., Seen], epal: PalletModel) -> None:
    seen, _, level = shown(0.0, 0.0)
    free = first_steps(replace(seen, level=None), epal, CONFIG)
    fine = first_steps(replace(seen, view=replace(seen.view, grid=replace(GRID, resolution=0.006))), epal, CONFIG)
    for steps in (level, free, fine):
        assert np.ptp(np.diff(steps.scales)) < 1e-9
        assert steps.scales.mean() == pytest.approx(1.0)
        assert steps.turn > np.radians(CONFIG.plane_yaw_deg + CONFIG.pallet_yaw_deg)
    assert np.diff(fine.scales)[0] == pytest.approx(np.diff(level.scales)[0] / 2, rel=0.1)
    # a face of free height does not move up or down with its distance
    assert np.diff(free.scales)[0] > 2 * np.diff(level.scales)[0]
    assert level.heights.tolist() == [0.0]
    assert free.heights[0] == pytest.approx(CONFIG.heights[0])
    assert free.heights[-1] > CONFIG.heights[1] - 0.05


def test_refining_moves_along_the_ray_and_does_not_lose_score(shown: Callable[..., Seen]) -> None:
    seen, template, steps = shown(0.73, 0.11, 0.05)
    first = search(seen, template, steps, CONFIG)
    second = refine(seen, template, steps, first, 1.0, CONFIG)
    assert len(second.place) == len(first.place)
    assert second.score.max() > first.score.max()
    assert (second.score >= first.score - 0.06).all()
    near = np.abs(second.depth - first.depth) <= np.diff(steps.scales)[0] * DISTANCE + 1e-9
    assert near.all()


def test_what_the_view_leaves_open_stays_near_the_nominal_plane(shown: Callable[..., Seen]) -> None:
    seen, template, steps = shown(0.3, 0.0)
    flat = [piece._replace(field=np.full_like(piece.field, 200)) for piece in template]
    sites = Sites(*(np.array([value]) for value in (0.3, 0.0, 0.0, 0.0, 0.0)))
    same = refine(seen, flat, steps, sites, 1.0, CONFIG)
    assert same.yaw[0] == pytest.approx(0.0, abs=1e-3)
    assert same.depth[0] == pytest.approx(0.0, abs=0.01)


def test_without_sites_there_is_nothing_to_refine(shown: Callable[..., Seen]) -> None:
    seen, template, steps = shown(0.0, 0.0)
    none = Sites(*(np.empty(0) for _ in range(5)))
    assert len(refine(seen, template, steps, none, 1.0, CONFIG).place) == 0


def test_the_best_of_what_stands_together_is_kept() -> None:
    rng = np.random.default_rng(0)
    sites = Sites(rng.uniform(0, 2, 300), rng.uniform(-0.2, 0.2, 300), *rng.uniform(0, 0.3, (3, 300)))
    kept = spaced(sites, sites.score, 1000, 0.144, CONFIG)
    assert kept[0] == sites.score.argmax()
    assert (np.diff(sites.score[kept]) <= 0).all()

    def near(i: int, j: int) -> bool:
        return bool(
            abs(sites.place[i] - sites.place[j]) < CONFIG.min_spacing
            and abs(sites.depth[i] - sites.depth[j]) < CONFIG.min_depth_spacing
            and abs(sites.height[i] - sites.height[j]) < 0.6 * 0.144
        )

    for rank, one in enumerate(kept):
        assert not any(near(one, other) for other in kept[:rank])
    for one in range(300):
        assert one in kept or any(near(one, other) and sites.score[other] >= sites.score[one] for other in kept)
    assert spaced(sites, sites.score, 5, 0.144, CONFIG).tolist() == kept[:5].tolist()
