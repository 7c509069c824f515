"""Find pallets on shelves in 360-degree shots and measure their poses, one shot at a time."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from palletloc.candidate import Candidate, Fit, Refusal
    from palletloc.choices import Method
    from palletloc.config import LocalizerConfig
    from palletloc.errors import PalletLocError
    from palletloc.geometry import LevelPose
    from palletloc.io.recording import Recording, read_recording
    from palletloc.localizer import Explanation, Localizer, Start
    from palletloc.measurement import PalletMeasurement, RefusedCandidate
    from palletloc.mounting import Mounting
    from palletloc.pallet import Opening, PalletModel
    from palletloc.pallet_library import find_models, load_library
    from palletloc.shelf import ShelfPlane
    from palletloc.shot import Shot

__version__ = "0.1.0"

# Loaded at first use: the command line answers `--help` without numpy, scipy and cv2.
_HOMES = {
    "Explanation": "localizer",
    "LevelPose": "geometry",
    "Localizer": "localizer",
    "LocalizerConfig": "config",
    "Method": "choices",
    "Mounting": "mounting",
    "Opening": "pallet",
    "PalletLocError": "errors",
    "PalletMeasurement": "measurement",
    "PalletModel": "pallet",
    "Recording": "io.recording",
    "Refusal": "candidate",
    "RefusedCandidate": "measurement",
    "Shot": "shot",
    "Fit": "candidate",
    "Candidate": "candidate",
    "ShelfPlane": "shelf",
    "Start": "localizer",
    "find_models": "pallet_library",
    "load_library": "pallet_library",
    "read_recording": "io.recording",
}

__all__ = [
    "Candidate",
    "Explanation",
    "Fit",
    "LevelPose",
    "Localizer",
    "LocalizerConfig",
    "Method",
    "Mounting",
    "Opening",
    "PalletLocError",
    "PalletMeasurement",
    "PalletModel",
    "Recording",
    "Refusal",
    "RefusedCandidate",
    "ShelfPlane",
    "Shot",
    "Start",
    "__version__",
    "find_models",
    "load_library",
    "read_recording",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'palletloc' has no attribute '{name}'")
    return getattr(importlib.import_module(f"palletloc.{_HOMES[name]}"), name)
