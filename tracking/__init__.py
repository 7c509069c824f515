"""Pallets over time: measurements of single shots fused with the forklift's odometry."""

from __future__ import annotations

from palletloc.track_status import Status
from tracking.answers import Knowledge, TrackState
from tracking.config import TrackerConfig
from tracking.events import Event, EventKind
from tracking.faults import UnknownTrackError
from tracking.latency import LatencyEstimate
from tracking.motion import Twist
from tracking.observation import PartialMeasurement
from tracking.odometry import Odometry, OdometryNoise, OdometrySource
from tracking.odometry_errors import OdometryErrors
from tracking.shot_taken import ShotTaken
from tracking.snapshot import SnapshotError
from tracking.tracker import PalletTracker

__all__ = [
    "Event",
    "EventKind",
    "Knowledge",
    "LatencyEstimate",
    "Odometry",
    "OdometryErrors",
    "OdometryNoise",
    "OdometrySource",
    "PalletTracker",
    "PartialMeasurement",
    "ShotTaken",
    "SnapshotError",
    "Status",
    "TrackState",
    "TrackerConfig",
    "Twist",
    "UnknownTrackError",
]
