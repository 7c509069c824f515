"""A place where a pallet may stand, and what every step found there."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from scipy.spatial.transform import RigidTransform

from palletloc.boundary import BoundaryLine
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.horizontal_view import HorizontalView
from palletloc.joint_search import JointSearch
from palletloc.measurement import HeightPrior, Reason, Stage, YawSource
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.position import Sweep
from palletloc.projection import Projector
from palletloc.refinement.alignment import FaceEstimate, YawPrior
from palletloc.refinement.search import Search
from palletloc.verification import NATS_PER_EDGE, Verification
from palletloc.yaw import YawEstimate

STEEP = 30
"""Power of scores from which on the highest one outweighs others that are lower by a few hundredths."""


@dataclass(frozen=True, slots=True)
class ShotView:
    """A shot with all that is needed to look at planes in it."""

    image: Image
    """The image."""
    projector: Projector
    """Of the camera that took it."""
    mounting: Mounting
    """Of that camera."""
    camera_from_forklift: RigidTransform
    """Inverse of the mounting."""


@dataclass(slots=True)
class Candidate:
    """One candidate on its way through the steps, each of which leaves its result here."""

    model: PalletModel
    """What it may be."""
    start: LevelPose
    """``forklift_from_pallet`` where the steps begin."""
    height: HeightPrior | None
    """What is known of its height."""
    score: float = 0.0
    """Of its detection, 0 to 1."""
    yaws: tuple[float, float] | None = None
    """Between which yaws it may stand, in radians; None where nothing says so."""
    lines: list[BoundaryLine] = field(default_factory=list)
    """Lines that the Hough transform found on the first horizontal view."""
    horizontal: list[HorizontalView] = field(default_factory=list)
    """The horizontal view, as first placed and after each correction."""
    yaw: YawEstimate | None = None
    """The yaw from the last horizontal view."""
    sweep: Sweep | None = None
    """The plane sweep."""
    search: Search | None = None
    """The hypotheses that were scored."""
    joint: JointSearch | None = None
    """The joint search."""
    face: FaceEstimate | None = None
    """The fit of the face's edges."""
    verification: Verification | None = None
    """The checks of the final pose."""
    pose: LevelPose | None = None
    """``forklift_from_pallet`` as measured; None until it is."""
    covariance: FloatArray | None = None
    """(4, 4) of the measured (x, y, z, yaw)."""
    yaw_from: YawSource = YawSource.FACE
    """What gave the yaw."""
    refusal: tuple[Stage, Reason] | None = None
    """Where and why it was given up."""

    @property
    def rank(self) -> float:
        """Its standing among candidates in one place, 0 to 1."""
        return self.verification.rank if self.verification else self.score

    @property
    def weight(self) -> float:
        """What it counts against others in its place: the evidence of what is seen of it, in nats.

        A mere score is no evidence, so that two lower ones do not add up to more than a higher one.
        """
        return self.verification.shown if self.verification else self.score**STEEP

    @property
    def likelihood(self) -> float:
        """How well its fit explains the image, as a logarithm, to be compared with others; -inf where it failed."""
        if self.face is None or self.verification is None:
            return -math.inf
        return self.verification.evidence - NATS_PER_EDGE * self.face.doubt

    @property
    def yaw_prior(self) -> YawPrior | None:
        """What the horizontal plane says of the yaw; None where the face has to give it."""
        if self.yaw is None:
            return None
        return YawPrior(self.yaw.sigma, self.model.height if self.yaw.source is YawSource.TOP else 0.0)

    def refuse(self, stage: Stage, reason: Reason) -> None:
        """Give it up."""
        self.refusal = (stage, reason)

    def take(self, other: Candidate) -> None:
        """Take over what another one's fit gave, or its refusal."""
        for name in ("horizontal", "yaw", "yaw_from", "face", "pose", "covariance", "verification", "refusal"):
            setattr(self, name, getattr(other, name))
