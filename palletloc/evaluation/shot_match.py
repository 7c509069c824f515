"""One shot against the truth: which estimate is of which pallet, what is missing, and what is false."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from palletloc.evaluation.errors import TrueFace, pair
from palletloc.evaluation.estimate import PalletEstimate
from palletloc.evaluation.estimate_error import EstimateError, estimate_error
from palletloc.evaluation.proportion import Proportion, clopper_pearson
from palletloc.geometry import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ShotMatch:
    """The estimates of one shot, each with its pallet, if any."""

    time: float
    """The shot's, in seconds."""
    errors: tuple[EstimateError, ...]
    """Of the visible pallets that were found, in the order of the pallets."""
    beyond: tuple[EstimateError, ...]
    """Of pallets that need not be found and were: neither counted nor held against the estimate."""
    missed: tuple[TrueFace, ...]
    """The visible pallets that were not found."""
    false: tuple[PalletEstimate, ...]
    """Estimates that belong to no pallet."""


def match_shot(
    time: float,
    estimates: Sequence[PalletEstimate],
    faces: Sequence[TrueFace],
    truth_covariances: Mapping[str, FloatArray] | None = None,
) -> ShotMatch:
    """Match the estimates of one shot with the true pallets, one to one, the closest pairs first.

    Parameters
    ----------
    time : float
        The shot's, in seconds.
    estimates : sequence of PalletEstimate
        Of that shot.
    faces : sequence of TrueFace
        Every true pallet, visible or not.
    truth_covariances : mapping of str to (4, 4) array, optional
        What the truth states of (x, y, z, yaw) in the forklift frame, for the pallets of which it does.

    Returns
    -------
    ShotMatch
        Every estimate and every visible pallet once. Nothing farther apart than
        `palletloc.evaluation.errors.PAIRING_DISTANCE` is matched.
    """
    known = truth_covariances or {}
    pairs = pair(estimates, faces)
    found = {
        column: estimate_error(time, estimates[row], faces[column], known.get(faces[column].id))
        for row, column in pairs
    }
    used = {row for row, _ in pairs}
    in_order = [found[column] for column in sorted(found)]
    return ShotMatch(
        time,
        tuple(one for one in in_order if one.error.face.visible),
        tuple(one for one in in_order if not one.error.face.visible),
        tuple(face for column, face in enumerate(faces) if face.visible and column not in found),
        tuple(one for row, one in enumerate(estimates) if row not in used),
    )


@dataclass(frozen=True, slots=True)
class Detection:
    """How many pallets were found in some shots, and how many estimates were of none."""

    shots: int
    """Number of shots."""
    found: Proportion
    """Visible pallets that were found, over all shots; its value is the recall."""
    false: int
    """Estimates that belong to no pallet."""

    @property
    def recall(self) -> float:
        """Part of the visible pallets that was found, 0 to 1; NaN without one."""
        return self.found.value

    @property
    def false_per_shot(self) -> float:
        """False estimates per shot; NaN without a shot."""
        return self.false / self.shots if self.shots else float("nan")


def detection(shots: Iterable[ShotMatch], confidence: float = 0.95) -> Detection:
    """Count what was found, missed and false.

    Parameters
    ----------
    shots : iterable of ShotMatch
        Of one or several recordings.
    confidence : float
        Of the recall's Clopper-Pearson interval.

    Returns
    -------
    Detection
        Every view of a pallet counts once.
    """
    shots = list(shots)
    found = sum(len(shot.errors) for shot in shots)
    visible = found + sum(len(shot.missed) for shot in shots)
    return Detection(len(shots), clopper_pearson(found, visible, confidence), sum(len(shot.false) for shot in shots))
