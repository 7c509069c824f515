"""One pallet in one place: candidates that stand in each other, and models that look alike at another distance.

Where nothing is known of the height, only the size of a face tells how far away it is: a smaller model nearer to
the camera covers the same part of the image as a larger one behind it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from palletloc.candidate import Candidate, ShotView
from palletloc.config import LocalizerConfig
from palletloc.geometry import LevelPose, wrap_angle
from palletloc.measurement import Reason, Stage
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.verification import NATS_PER_EDGE, of_use, outline, overlaps

Measure = Callable[[ShotView, Candidate, LocalizerConfig], None]
"""Measures a candidate in a shot: leaves a pose or a refusal in it."""

MOST_RIVALS = 16
"""Most candidates in one heap of which the likeliest are looked for; the least likely ones beyond are given up."""
FAR_APART = 3.0
"""From how many standard deviations on another fit's pose is another pose."""


def exclude_overlaps(candidates: Iterable[Candidate]) -> None:
    """Refuse candidates that stand in each other until no two do: those stay that together are the likeliest.

    Two pallets side by side outweigh one that would stand in both. What shows a pallet's blocks and openings but was
    given up for its edges or its height keeps its place, too: whatever else is found there is that pallet, seen
    wrongly. Where it was given up as uncertain, though, another fit of about the same pose may be of use.

    Parameters
    ----------
    candidates : iterable of Candidate
        All of one shot, after they were measured.
    """
    standing = [one for one in candidates if one.pose is not None and (one.refusal is None or _is_pallet(one))]
    standing.sort(key=lambda one: -one.rank)
    if not standing:
        return
    poses = np.array([one.pose.as_array() for one in standing if one.pose is not None])
    outlines = np.array([outline(one.model) for one in standing])
    clash = overlaps(poses[:, None], outlines[:, None], poses, outlines)
    clash = (clash | clash.T) & ~np.eye(len(standing), dtype=bool)
    for i, j in np.argwhere(np.triu(clash)).tolist():
        clash[i, j] = clash[j, i] = not _one_of_use(standing[i], standing[j])
    stays = _likeliest([one.weight for one in standing], [frozenset(np.flatnonzero(row).tolist()) for row in clash])
    for i, candidate in enumerate(standing):
        if i not in stays and candidate.refusal is None:
            candidate.refuse(Stage.VERIFICATION, Reason.OVERLAP)


def _one_of_use(one: Candidate, other: Candidate) -> bool:
    """Tell whether of two poses of one pallet, as far as their fits can tell, one alone was given up as uncertain."""
    given_up = [each.refusal is not None and each.refusal[1] is Reason.UNCERTAIN for each in (one, other)]
    if sum(given_up) != 1 or one.face is None or other.face is None:
        return False
    apart = one.face.forklift_from_pallet.as_array() - other.face.forklift_from_pallet.as_array()
    apart[3] = wrap_angle(apart[3])
    return bool(apart @ np.linalg.solve(one.face.covariance + other.face.covariance, apart) < FAR_APART**2)


def _likeliest(weights: Sequence[float], clashes: Sequence[frozenset[int]]) -> frozenset[int]:
    """Return which of some candidates stay, so that none clash and their weights sum up to the most."""
    left, stays = set(range(len(weights))), frozenset[int]()
    while left:
        group, found = {min(left)}, {min(left)}
        while found:
            found = set().union(*(clashes[i] for i in found)) - group
            group |= found
        left -= group
        stays |= _best(sorted(group, key=lambda i: -weights[i])[:MOST_RIVALS], weights, clashes)[1]
    return stays


def _best(
    among: Sequence[int], weights: Sequence[float], clashes: Sequence[frozenset[int]]
) -> tuple[float, frozenset[int]]:
    """Return the greatest sum of weights without a clash, and whose; of equal ones that with the first."""
    if not among:
        return 0.0, frozenset()
    first, rest = among[0], among[1:]
    weight, chosen = _best([i for i in rest if i not in clashes[first]], weights, clashes)
    with_it = weight + weights[first], chosen | {first}
    if not clashes[first].intersection(rest):
        return with_it
    without = _best(rest, weights, clashes)
    return with_it if with_it[0] >= without[0] else without


def _is_pallet(candidate: Candidate) -> bool:
    lost = candidate.refusal is not None and candidate.refusal[1] is Reason.OVERLAP
    return candidate.verification is not None and candidate.verification.reason is None and not lost


def challenge(
    shot: ShotView, candidate: Candidate, others: Iterable[PalletModel], measure: Measure, config: LocalizerConfig
) -> None:
    """Try other models in a candidate's place in the image, where its height is unknown.

    Parameters
    ----------
    shot : ShotView
        The shot.
    candidate : Candidate
        After it was measured; is refused where another model explains the image better, and becomes less certain as
        far as another one is likely.
    others : iterable of PalletModel
        What else may stand there.
    measure : callable
        Measures a candidate.
    config : LocalizerConfig
        Parameters.
    """
    if candidate.height is not None or candidate.face is None:
        return
    for model in others:
        if candidate.refusal is not None or candidate.pose is None:
            return
        rival = Candidate(model, _seen_as(model, candidate, candidate.pose, shot.mounting), None)
        measure(shot, rival, config)
        compete(candidate, rival, config)


def compete(candidate: Candidate, rival: Candidate, config: LocalizerConfig) -> None:
    """Compare a candidate with a rival in the same place of the image, of which only one can be right.

    Parameters
    ----------
    candidate : Candidate
        With a pose; is refused where the rival explains the image better at another pose, and becomes less certain as
        far as the rival is likely.
    rival : Candidate
        Measured in the same shot.
    config : LocalizerConfig
        Parameters.
    """
    gain = rival.likelihood - candidate.likelihood
    # where an edge more speaks for the candidate there is no rival
    if rival.pose is None or candidate.pose is None or candidate.covariance is None or gain < -NATS_PER_EDGE:
        return
    apart = rival.pose.as_array() - candidate.pose.as_array()
    apart[3] = wrap_angle(apart[3])
    # what doubt has added to the covariance is no reason to believe in the worse of two
    fitted = candidate.covariance if candidate.face is None else candidate.face.covariance
    if gain > 0 and apart @ np.linalg.solve(fitted, apart) > FAR_APART**2:
        candidate.refuse(Stage.VERIFICATION, Reason.OVERLAP)
        return
    candidate.covariance = candidate.covariance + np.outer(apart, apart) / (1 + np.exp(-gain))
    if not of_use(candidate.covariance, config.verification):
        candidate.refuse(Stage.VERIFICATION, Reason.UNCERTAIN)


def _seen_as(model: PalletModel, candidate: Candidate, pose: LevelPose, mounting: Mounting) -> LevelPose:
    """Return where another model would appear as wide as a candidate, in the same direction."""
    place, center = np.array([pose.x, pose.y, pose.z]), mounting.center
    x, y, z = (center + model.width / candidate.model.width * (place - center)).tolist()
    return LevelPose(x, y, z, pose.yaw)
