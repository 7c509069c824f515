"""How much a track is believed: a word that the tracker and the readers of its files share."""

from __future__ import annotations

from enum import StrEnum


class Status(StrEnum):
    """How much a track is believed."""

    TENTATIVE = "tentative"
    """Seen too few times to be believed."""
    CONFIRMED = "confirmed"
    """Seen often enough, and in the last shot."""
    COASTING = "coasting"
    """Believed, but not seen of late: odometry alone says where it is."""
