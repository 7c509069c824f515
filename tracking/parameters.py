"""The tracker's parameters in the file that holds the localizer's, too: its section ``tracker``."""

from __future__ import annotations

from pathlib import Path

from palletloc.io.config_file import Ranges, format_section, read_section
from tracking.config import TrackerConfig

SECTION = "tracker"
"""Its key."""
_MEANING = "Pallets over time: what palletloc track adds to the measurements of single shots."
RANGES: Ranges = (
    ("adapt_over", 0, 1000),
    ("adapt_probability", 0.5, 1 - 1e-6),
    ("probability", 0.5, 1 - 1e-6),
    ("robust_probability", 0.5, 1 - 1e-6),
    ("min_scale", 0.01, 1),
    ("max_scale", 1, 1e4),
    ("max_common_share", 0, 0.99),
    ("common_path_m", 0.01, 1e4),
    ("latency_s", -10, 10),
    ("max_distance_m", 0.01, 100),
    ("max_speed_mps", 0.1, 100),
    ("max_turn_dps", 1, 3600),
    ("turn_acceleration_dps2", 0, 3600),
    ("max_ahead_s", 0, 60),
    ("tracks_together", 1, 50),
    ("window_s", 0.01, 600),
    ("max_jump_s", 0.1, 1e6),
    ("tentative_age_s", 0.01, 3600),
    ("coast_after_s", 0, 3600),
    ("max_coast_s", 0.01, 1e5),
    ("max_sigma_m", 0.001, 100),
    ("*_mm_per_sqrt_m", 0, 1000),
    ("*_mm_per_sqrt_s", 0, 1000),
    ("*", 0, 100),
)
"""Least and greatest value of each parameter, by its name; the first pattern that fits holds."""


def read_tracker_config(path: Path) -> TrackerConfig:
    """Read the tracker's parameters.

    Parameters
    ----------
    path : Path
        A yaml file, such as ``tracker: {life: {confirm_hits: 4}}``; its other sections are not looked at.

    Returns
    -------
    TrackerConfig
        The file's values, and the defaults of all others.

    Raises
    ------
    InputError
        If the file cannot be read, a key is unknown (names the nearest), or a value is of the wrong kind or out of
        range; names the key.
    """
    return read_section(path, SECTION, TrackerConfig, RANGES)


def format_tracker_config(config: TrackerConfig | None = None) -> str:
    """Return every parameter of the tracker as text that may follow `palletloc.io.config_file.format_config`.

    Parameters
    ----------
    config : TrackerConfig, optional
        The values; the defaults if left out.
    """
    return format_section(SECTION, config or TrackerConfig(), _MEANING)
