"""Pallets over time: measurements of single shots fused with the forklift's odometry."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

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
from tracking.smoother import smoothed as smoothed
from tracking.track_state import Knowledge as Knowledge
from tracking.track_state import TrackState as TrackState
from tracking.tracker import PalletTracker as PalletTracker
from tracking.validation import UnknownTrackError as UnknownTrackError

if TYPE_CHECKING:
    from tracking.recording import track_recording as track_recording
    from tracking.streaming import RecordingSource as RecordingSource
    from tracking.streaming import ShelfLocalizer as ShelfLocalizer
    from tracking.streaming import stream as stream

_HOMES = {
    "RecordingSource": "streaming",
    "ShelfLocalizer": "streaming",
    "stream": "streaming",
    "track_recording": "recording",
}
"""Modules of the names that are loaded at first use: they read images and files, which the tracker does not need."""


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'tracking' has no attribute '{name}'")
    return getattr(importlib.import_module(f"tracking.{_HOMES[name]}"), name)
