"""Every parameter in one place: the parts belong to the steps."""

from __future__ import annotations

from dataclasses import dataclass, field

from palletloc.paper.horizontal_view import YawConfig
from palletloc.paper.joint_search import JointSearchConfig
from palletloc.paper.position import PositionConfig
from palletloc.prior import PriorConfig
from palletloc.refinement.face_fit import FaceFitConfig
from palletloc.refinement.hypotheses import SearchConfig
from palletloc.shelf_view import DetectionConfig
from palletloc.verification import VerificationConfig

RANGE_SLACK = 1.2
"""How much farther than pallets that are looked for a start may be: it need not be where the pallet is."""


@dataclass(frozen=True, slots=True)
class LocalizerConfig:
    """Parameters of every step."""

    prior: PriorConfig = field(default_factory=PriorConfig)
    """What is known before anything is measured."""
    detection: DetectionConfig = field(default_factory=DetectionConfig)
    """Finding pallets on the shelf plane (paper's A)."""
    yaw: YawConfig = field(default_factory=YawConfig)
    """Yaw from the horizontal plane (B)."""
    search: SearchConfig = field(default_factory=SearchConfig)
    """Hypotheses around a start."""
    position: PositionConfig = field(default_factory=PositionConfig)
    """Position by the plane sweep (C)."""
    face_fit: FaceFitConfig = field(default_factory=FaceFitConfig)
    """The edges of the face to a fraction of a pixel."""
    verification: VerificationConfig = field(default_factory=VerificationConfig)
    """The checks of the final pose."""
    joint_search: JointSearchConfig = field(default_factory=JointSearchConfig)
    """The baseline."""

    @property
    def farthest_start(self) -> float:
        """How far from the camera a place to begin from may be, in metres."""
        return RANGE_SLACK * self.detection.max_range
