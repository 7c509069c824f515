"""Pallets over time: measurements of single shots fused with the forklift's odometry."""

from __future__ import annotations

from typing import TYPE_CHECKING

from palletloc.lazy import late_names

if TYPE_CHECKING:
    from palletloc.track_status import Status as Status
    from tracking.config import TrackerConfig as TrackerConfig
    from tracking.events import Event as Event
    from tracking.events import EventKind as EventKind
    from tracking.latency import LatencyEstimate as LatencyEstimate
    from tracking.motion import Twist as Twist
    from tracking.observation import PartialMeasurement as PartialMeasurement
    from tracking.observation import ShotTaken as ShotTaken
    from tracking.odometry import Odometry as Odometry
    from tracking.odometry import OdometryNoise as OdometryNoise
    from tracking.odometry import OdometrySource as OdometrySource
    from tracking.odometry_errors import OdometryErrors as OdometryErrors
    from tracking.plain_values import SnapshotError as SnapshotError
    from tracking.recording import track_recording as track_recording
    from tracking.smoother import smoothed as smoothed
    from tracking.streaming import RecordingSource as RecordingSource
    from tracking.streaming import ShelfLocalizer as ShelfLocalizer
    from tracking.streaming import stream as stream
    from tracking.track_state import Knowledge as Knowledge
    from tracking.track_state import TrackState as TrackState
    from tracking.tracker import PalletTracker as PalletTracker
    from tracking.validation import UnknownTrackError as UnknownTrackError

__getattr__ = late_names(__name__, __file__)
"""Imports a name at its first use: a command's help, and what needs a part of the package, load no more than that."""
