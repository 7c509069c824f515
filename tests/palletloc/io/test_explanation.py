import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from palletloc import Explanation, Fit, LevelPose, Localizer, PalletModel, Refusal, Shot, Start
from palletloc.candidate import last_step
from palletloc.io.explanation import explanation_document
from palletloc.measurement import Reason, Stage
from palletloc.refinement.search import Search

POSE = LevelPose(0.4, 2.0, 0.0, np.radians(91))
START = replace(POSE, y=2.05)


@pytest.fixture(scope="module")
def explained(portrait: Callable[..., Shot], t11: PalletModel) -> Explanation:
    return Localizer([t11]).explain_from(portrait(t11, POSE), [Start("t11", START)], (0.0,))


@pytest.fixture(scope="module")
def fit(explained: Explanation) -> Fit:
    (found,) = explained.outcomes
    assert isinstance(found, Fit)
    return found


@pytest.fixture(scope="module")
def search(fit: Fit) -> Search:
    found = last_step(fit, Search)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def numbers(explained: Explanation, fit: Fit) -> dict[str, Any]:
    document = explanation_document(explained, [("P1", fit)], "refined")
    read: dict[str, Any] = json.loads(json.dumps(document, allow_nan=False))["candidates"][0]
    return read


def test_the_table_of_scores_has_its_axes(numbers: dict[str, Any], search: Search) -> None:
    table = numbers["search"]
    assert np.shape(table["score"]) == (len(table["yaw_rad"]), len(table["range_m"]))
    assert np.array(table["score"]) == pytest.approx(search.found.score, rel=1e-5)
    assert table["yaw_rad"][0] < START.yaw < table["yaw_rad"][-1]
    away = float(np.hypot(START.x - 0.3, START.y + 0.08))
    assert table["range_m"][0] < away < table["range_m"][-1]


def test_the_best_peak_is_near_the_pallet(numbers: dict[str, Any]) -> None:
    peaks = numbers["search"]["peaks"]
    scores = [peak["score"] for peak in peaks]
    assert scores == sorted(scores, reverse=True)
    assert peaks[0]["pose"]["y_m"] == pytest.approx(POSE.y, abs=0.03)
    assert peaks[0]["range_m"] == pytest.approx(np.hypot(POSE.x - 0.3, POSE.y + 0.08), abs=0.03)


def test_every_edge_says_what_became_of_it(numbers: dict[str, Any], fit: Fit) -> None:
    assert fit.face is not None
    edges = numbers["face"]["edges"]
    assert [edge["number"] for edge in edges] == list(range(1, len(edges) + 1))
    assert {edge["fate"] for edge in edges} <= {"used", "rejected", "not_seen", "hidden"}
    measured = [edge for edge in edges if "offset_m" in edge]
    assert len(measured) == len(fit.face.seen.edges)
    assert all(edge["fate"] in ("used", "rejected") and edge["sigma_m"] > 0 for edge in measured)
    assert [edge["load_above"] for edge in edges] == [edge["edge"] == "top" for edge in edges]


def test_the_ellipse_is_the_covariances(numbers: dict[str, Any]) -> None:
    ellipse, covariance = numbers["ellipse"], np.array(numbers["covariance"])[:2, :2]
    heading = ellipse["heading_rad"]
    axes = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    rebuilt = axes @ np.diag([ellipse["major_m"] ** 2, ellipse["minor_m"] ** 2]) @ axes.T
    assert rebuilt == pytest.approx(covariance, rel=1e-3, abs=1e-9)
    assert ellipse["major_m"] >= ellipse["minor_m"]


def test_closer_searches_are_listed(explained: Explanation, fit: Fit, search: Search) -> None:
    coarse = replace(fit, steps=(replace(search, finer=(search,)),))
    (document,) = explanation_document(explained, [("P1", coarse)], "refined")["candidates"]
    (closer,) = document["search"]["closer"]
    assert set(closer) >= {"yaw_rad", "range_m", "score", "peaks"}


def test_a_refusal_says_where_and_why_and_what_was_measured(explained: Explanation, fit: Fit) -> None:
    measured = Refusal(fit.candidate, Stage.VERIFICATION, Reason.OVERLAP, fit, fit.steps)
    unseen = Refusal(fit.candidate, Stage.START, Reason.OUT_OF_RANGE)
    found, kept, lost = explanation_document(explained, [("P1", fit), ("C1", measured), ("C2", unseen)], "refined")[
        "candidates"
    ]
    assert "refused" not in found
    assert kept.pop("refused") == {"stage": "verification", "reason": "overlap"}
    assert kept | {"name": "P1"} == found
    assert lost["refused"] == {"stage": "start", "reason": "out_of_range"}
    assert set(lost) == {"name", "model", "detection_score", "start", "refused"}
