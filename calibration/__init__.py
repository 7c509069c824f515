"""Where the camera and the shelf are: the mounting on the forklift, the lenses, and the shelf's front plane.

Printed targets and what shots show of them; the camera's pose on the forklift from a survey, its check by a drive or
by what is plumb and level, and its plan before anyone drives; the lenses' parameters, and camera files of other
programs; the shelf's front from a drive past it. It imports nothing but `palletloc`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calibration.findings import Finding
    from calibration.motion.assessment import calibrate_motion
    from calibration.mounting.assessment import calibrate_mounting
    from calibration.plan.assessment import plan_targets

# Loaded at first use: the command line answers `--help` without numpy, scipy and cv2.
_HOMES = {
    "Finding": "findings",
    "calibrate_motion": "motion.assessment",
    "calibrate_mounting": "mounting.assessment",
    "plan_targets": "plan.assessment",
}
"""Where each public name is defined, below `calibration`."""
__all__ = ["Finding", "calibrate_motion", "calibrate_mounting", "plan_targets"]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'calibration' has no attribute '{name}'")
    return getattr(importlib.import_module(f"calibration.{_HOMES[name]}"), name)
