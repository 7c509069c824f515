"""The measurements of a recording beside its truth, each with what it says of its own uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palletloc.evaluation.errors import PoseError, Sight, TrueFace, pair, pose_error, true_faces
from palletloc.geometry import BoolArray, FloatArray
from palletloc.io.recording import Recording
from palletloc.io.truth import Truth
from palletloc.measurement import PalletMeasurement


@dataclass(frozen=True, slots=True)
class MeasuredError:
    """A measurement with its error."""

    measured: PalletMeasurement
    """The measurement."""
    error: PoseError
    """Measured minus true."""

    @property
    def offset(self) -> FloatArray:
        """(4,) error in depth, along and height in metres, and in yaw in radians."""
        return np.array([self.error.depth, self.error.along, self.error.height, self.error.yaw])

    @property
    def sigma(self) -> FloatArray:
        """(4,) standard deviations that the measurement states of the same four."""
        yaw = self.error.face.forklift_from_pallet.yaw
        cos, sin = float(np.cos(yaw)), float(np.sin(yaw))
        turn = np.array([[cos, sin, 0, 0], [-sin, cos, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        return np.asarray(np.sqrt(np.diag(turn @ self.measured.covariance @ turn.T)))

    @property
    def is_covered(self) -> BoolArray:
        """(4,) whether each error lies within two standard deviations."""
        return np.abs(self.offset) <= 2 * self.sigma


@dataclass(frozen=True, slots=True)
class Comparison:
    """All measurements of a recording against its truth."""

    errors: tuple[MeasuredError, ...]
    """Of the measurements that belong to a pallet, shot by shot."""
    unmatched: tuple[PalletMeasurement, ...]
    """Measurements where no pallet stands."""
    missed: tuple[TrueFace, ...]
    """Pallets that should have been found, once for each shot that missed them."""
    sight: Sight
    """Which pallets should be found."""

    @property
    def found(self) -> int:
        """How many of the pallets that should be found were, over all shots."""
        return sum(one.error.face.visible for one in self.errors)


def compare(recording: Recording, truth: Truth, measured: Sequence[PalletMeasurement]) -> Comparison:
    """Compare the measurements of a recording with its truth.

    Parameters
    ----------
    recording : Recording
        Gives the shots, the mounting and the pallet models.
    truth : Truth
        Of the recording.
    measured : sequence of PalletMeasurement
        With the times of the shots.

    Returns
    -------
    Comparison
        A shot without a measurement counts, too.

    Raises
    ------
    PalletLocError
        If the truth does not cover a shot, or has a pallet of another model.
    """
    widths = {model.name: model.width for model in recording.models}
    sight = Sight()
    errors: list[MeasuredError] = []
    unmatched: list[PalletMeasurement] = []
    missed: list[TrueFace] = []
    for shot in recording.shots:
        found = [one for one in measured if one.time == shot.time]
        world_from_forklift = truth.forklift.pose_at(shot.time)
        faces = true_faces(truth.pallets, widths, world_from_forklift, recording.forklift_from_camera, sight)
        pairs = dict(pair(found, faces))
        errors += [MeasuredError(found[row], pose_error(found[row], faces[pairs[row]])) for row in sorted(pairs)]
        unmatched += [one for row, one in enumerate(found) if row not in pairs]
        missed += [face for i, face in enumerate(faces) if face.visible and i not in pairs.values()]
    return Comparison(tuple(errors), tuple(unmatched), tuple(missed), sight)
