"""Which pallet stands there: rivals of other models, looked for or not, and what tells them apart."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palletloc import Fit, LevelPose, Localizer, PalletMeasurement, PalletModel, Refusal, Start
from palletloc.candidate import Candidate
from palletloc.geometry import level_pose
from palletloc.io.recording import Recording, read_recording
from palletloc.io.truth import Truth, read_truth
from palletloc.measurement import Reason, Stage
from palletloc.methods import measure_refined
from palletloc.other_models import DIFFERENT, WRONG_MODEL, other_models, unstated_models
from palletloc.pallet_library import load_library
from palletloc.shot import Shot
from tests.palletloc.poses import CONFIG, FLOOR, POSE, Outcome, Portrait, found, moved, slid

LIBRARY = load_library()
EXACT = [name for name, model in LIBRARY.items() if model.tolerance <= 0.001]
"""Models whose dimensions are known to a millimetre."""


def measured(shot: Shot, model: PalletModel, start: LevelPose = POSE) -> Outcome:
    return measure_refined(shot, Candidate(model, start, FLOOR), CONFIG)


def given_up(fit: Fit, reason: Reason = Reason.UNCERTAIN) -> Refusal:
    return Refusal(fit.candidate, Stage.VERIFICATION, reason, fit)


def never(*_: object) -> Outcome:
    raise AssertionError("nothing has to be measured")


# Those that are looked for, at any height.


@pytest.mark.parametrize("names", [("epal", "t11"), ("t11", "epal")], ids="-as-".join)
def test_at_any_height_a_model_gives_way_to_the_one_that_stands_there(
    names: tuple[str, str], portrait: Portrait, request: pytest.FixtureRequest
) -> None:
    model, other = (request.getfixturevalue(name) for name in names)
    shot = portrait(model, POSE)
    # where the other model would look as wide
    starts = [Start(other.name, slid(shot, POSE, other.width / model.width)), Start(model.name, POSE)]
    wrong, right = Localizer([model, other]).explain_from(shot, starts).outcomes
    assert isinstance(wrong, Refusal)
    assert isinstance(right, Fit)
    assert np.abs(right.pose.minus(POSE))[:3].max() < 0.03


def test_models_alike_contradict_nothing_and_on_a_level_none_is_tried(portrait: Portrait, t11: PalletModel) -> None:
    shot, alike = portrait(t11, POSE), replace(t11, name="alike", width=t11.width + 0.002)
    alone, together = (
        Localizer(models).localize_from(shot, [Start("t11", POSE)])[0] for models in ([t11], [t11, alike])
    )
    assert alone is not None
    assert together is not None
    assert together.forklift_from_pallet == alone.forklift_from_pallet
    assert (np.diag(together.covariance) >= np.diag(alone.covariance)).all()
    shot, other = portrait(t11, POSE), replace(t11, name="other", width=1.2)
    known = found(measured(shot, t11))
    free = replace(known, candidate=replace(known.candidate, height=None))
    for best, model in ((known, other), (free, t11), (given_up(free), other), (replace(free, face=None), other)):
        assert list(other_models(shot, best, [model], never, CONFIG)) == []


# Those that nobody looked for.


@pytest.mark.parametrize("name", EXACT)
def test_the_right_model_stays_whatever_else_there_is(name: str, portrait: Portrait) -> None:
    model, start = LIBRARY[name], Start(name, POSE)
    shot = portrait(model, POSE)
    alone, against = (
        Localizer([model], library=library).localize_from(shot, [start], (0.0,))[0] for library in ((), None)
    )
    assert alone is not None
    assert against is not None
    assert against.forklift_from_pallet == alone.forklift_from_pallet
    assert (np.diag(against.covariance) >= np.diag(alone.covariance) * (1 - 1e-9)).all()


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("stated", [*EXACT, "gma-1016", "cp3", "chep-us-1219"])
def test_a_wrong_model_gives_no_confident_row_aside(name: str, stated: str, portrait: Portrait) -> None:
    right, wrong = LIBRARY[name], LIBRARY[stated]
    if right.largest_difference(wrong) < DIFFERENT:
        return
    shot = portrait(right, POSE)
    asides = [0.0, (right.width - wrong.width) / 2, (wrong.width - right.width) / 2]
    starts = [Start(stated, moved(POSE, aside)) for aside in asides]
    for outcome in Localizer([wrong]).explain_from(shot, starts, (0.0,)).outcomes:
        if isinstance(outcome, Fit):
            error = outcome.pose.minus(POSE)
            assert np.linalg.norm(error[:3]) < DIFFERENT or error @ np.linalg.solve(outcome.covariance, error) < 16.0
        elif outcome.better is not None:
            assert outcome.reason is Reason.OTHER_MODEL
            assert LIBRARY[outcome.better.name].largest_difference(right) < DIFFERENT
            assert outcome.better.nats > np.log(1 / WRONG_MODEL - 1)


def test_a_wrong_model_is_named_with_the_right_one(portrait: Portrait) -> None:
    right, wrong = LIBRARY["t11-plastic"], LIBRARY["epal1-1200"]
    shot = portrait(right, POSE)
    start = [Start(wrong.name, moved(POSE, 0.05))]
    (wrongly,) = Localizer([wrong], library=()).explain_from(shot, start, (0.0,)).outcomes
    assert isinstance(wrongly, Fit)  # without the library nobody notices
    explained = Localizer([wrong]).explain_from(shot, start, (0.0,))
    (refused,) = explained.refusals
    assert refused.better is not None
    assert refused.better.name == right.name
    assert right.name in str(refused.better)


def test_a_model_gains_by_edges_near_their_drawing_only_what_its_tolerance_allows(portrait: Portrait) -> None:
    model = LIBRARY["t11-plastic"]
    shot = portrait(model, POSE)
    gains = []
    for tolerance in (0.001, 0.003, 0.010):
        face = found(measured(shot, replace(model, tolerance=tolerance))).face
        assert face is not None
        assert face.nearness <= face.attainable
        gains.append(face.nearness)
    assert gains == sorted(gains, reverse=True)
    assert gains[0] > 6.0 > gains[-1]


def test_nothing_is_measured_where_the_edges_lie_on_their_drawing_or_no_model_differs(portrait: Portrait) -> None:
    model = LIBRARY["t11-plastic"]
    best = found(measured(portrait(model, POSE), model))
    shot, alike = portrait(model, POSE), replace(model, name="alike", width=model.width + 0.01)
    assert list(unstated_models(shot, best, LIBRARY.values(), never, CONFIG)) == []
    assert best.face is not None
    doubtful = replace(best, face=replace(best.face, doubt=3.0))
    assert list(unstated_models(shot, doubtful, [alike], never, CONFIG)) == []
    assert list(unstated_models(shot, given_up(doubtful), LIBRARY.values(), never, CONFIG)) == []


def test_differences_of_models_are_those_of_their_lines() -> None:
    t11, epal, stringers = (LIBRARY[name] for name in ("t11-plastic", "epal1-1200", "gma-1016"))
    assert t11.largest_difference(t11) == 0.0
    assert t11.largest_difference(epal) == epal.largest_difference(t11)
    assert t11.largest_difference(epal) == pytest.approx(0.05, abs=1e-9)  # half of what the widths differ by
    one = replace(t11, openings=t11.openings[:1])
    assert np.isinf(one.largest_difference(stringers))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "stated"), [("dev_lab", "epal1-1200"), ("dev_warehouse", "gma-1016")])
def test_recordings_with_a_wrong_model_have_no_confident_rows_aside(
    name: str, stated: str, shared_data: Path
) -> None:
    recording, truth = read_recording(shared_data / name), read_truth(shared_data / name)
    aside, without = (
        sum(_is_aside(row, truth) for row in _rows(recording, Localizer([LIBRARY[stated]], library=library)))
        for library in (None, ())
    )
    assert without >= 5
    assert aside == 0


def _rows(recording: Recording, localizer: Localizer) -> Iterator[PalletMeasurement]:
    for entry in recording.shots[::2]:
        yield from localizer.localize(recording.shot(entry), recording.shelf_at(entry.time))


def _is_aside(row: PalletMeasurement, truth: Truth) -> bool:
    """Tell whether a row is far from every pallet, by its covariance as well."""
    forklift = truth.forklift.pose_at(row.time).transform().inv()
    errors = [
        row.forklift_from_pallet.minus(level_pose(forklift * pallet.world_from_pallet.transform()))
        for pallet in truth.pallets
    ]
    error = min(errors, key=lambda error: float(np.linalg.norm(error[:3])))
    sigmas = math.sqrt(error @ np.linalg.solve(row.covariance, error))
    return bool(np.linalg.norm(error[:3]) > DIFFERENT and sigmas > 4.0)
