"""Where the camera and the shelf are: the mounting on the forklift, the lenses, and the shelf's front plane.

Printed targets and what shots show of them; the camera's pose on the forklift from a survey, its check by a drive or
by what is plumb and level, and its plan before anyone drives; the lenses' parameters, and camera files of other
programs; the shelf's front from a drive past it. It imports nothing but `palletloc`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calibration.check.assessment import check_mounting
    from calibration.findings import Finding
    from calibration.formats.convert import convert_camera
    from calibration.intrinsics.fit import calibrate_lenses
    from calibration.motion.assessment import calibrate_motion
    from calibration.mounting.assessment import calibrate_mounting
    from calibration.plan.assessment import plan_targets
    from calibration.shelf.assessment import calibrate_shelf

# Loaded at first use: the command line answers `--help` without numpy, scipy and cv2.
_HOMES = {
    "Finding": "findings",
    "calibrate_lenses": "intrinsics.fit",
    "calibrate_motion": "motion.assessment",
    "calibrate_mounting": "mounting.assessment",
    "calibrate_shelf": "shelf.assessment",
    "check_mounting": "check.assessment",
    "convert_camera": "formats.convert",
    "plan_targets": "plan.assessment",
}
"""Where each public name is defined, below `calibration`."""
__all__ = [
    "Finding",
    "calibrate_lenses",
    "calibrate_motion",
    "calibrate_mounting",
    "calibrate_shelf",
    "check_mounting",
    "convert_camera",
    "plan_targets",
]
"""The names in the order of `_HOMES`, as checkers of types and style read them."""


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'calibration' has no attribute '{name}'")
    return getattr(importlib.import_module(f"calibration.{_HOMES[name]}"), name)
