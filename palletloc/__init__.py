"""Find pallets on shelves in 360-degree shots and measure their poses, one shot at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from palletloc.lazy import late_names

if TYPE_CHECKING:
    from palletloc.cameras.protocol import CameraModel as CameraModel
    from palletloc.candidate import Candidate as Candidate
    from palletloc.candidate import Fit as Fit
    from palletloc.candidate import Refusal as Refusal
    from palletloc.choices import Method as Method
    from palletloc.config import LocalizerConfig as LocalizerConfig
    from palletloc.errors import PalletLocError as PalletLocError
    from palletloc.geometry import LevelPose as LevelPose
    from palletloc.io.camera_spec import read_camera as read_camera
    from palletloc.io.recording import Recording as Recording
    from palletloc.io.recording import read_recording as read_recording
    from palletloc.localizer import Explanation as Explanation
    from palletloc.localizer import Localizer as Localizer
    from palletloc.localizer import Start as Start
    from palletloc.measurement import PalletMeasurement as PalletMeasurement
    from palletloc.measurement import RefusedCandidate as RefusedCandidate
    from palletloc.mounting import Mounting as Mounting
    from palletloc.pallet import Opening as Opening
    from palletloc.pallet import PalletModel as PalletModel
    from palletloc.pallet_library import find_models as find_models
    from palletloc.pallet_library import load_library as load_library
    from palletloc.shelf import ShelfPlane as ShelfPlane
    from palletloc.shot import Shot as Shot

__version__ = "0.1.0"

__getattr__ = late_names(__name__, __file__)
"""Imports a name at its first use: a command's help, and what needs a part of the package, load no more than that."""
