"""From a folder of shots to lenses: boards are found, lenses fitted, and the corners measured again through them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.findings import PASS, Finding, Severity, exit_code
from calibration.intrinsics.assessment import AROUND, Checked, check_fit, check_stitched, view_findings
from calibration.intrinsics.board_views import Collected, collect, measure_again
from calibration.intrinsics.result import FittedCamera, fitted_camera, measuring_lenses
from calibration.intrinsics.stitched import StitchedFit, fit_stitched, whole_pose
from calibration.intrinsics.task import INTRINSICS, Chessboard, IntrinsicsTask, read_intrinsics
from calibration.lenses.fit import LensFit, NoStartError, fit_lenses
from calibration.lenses.linking import UnlinkedError
from calibration.lenses.models import MODELS, LensModel, lens_model
from palletloc.cameras import CameraModel, Equirectangular
from palletloc.errors import PalletLocError, nearest_name
from palletloc.io.yaml_document import DocumentError

STITCHED = "stitched_equirectangular"
"""Name of the model of two lenses behind a stitched image."""
_MEASURED_AGAIN = 3
"""How often the corners are measured again: they lean on the lens that they are measured through, ever less."""
_TILT = "tilt the board by 30 degrees and more in several directions, and bring it to the rim of the image"
"""What helps where boards leave a lens open."""


@dataclass(frozen=True, slots=True, eq=False)
class LensCalibration:
    """Lenses from boards."""

    model: str
    """Name of the lens model."""
    findings: tuple[Finding, ...]
    """In the order in which they were made."""
    found: Collected
    """What the shots show."""
    fit: LensFit | None = None
    """The fit, where there is one."""
    fitted: FittedCamera | None = None
    """What it gives."""
    checked: Checked | None = None
    """What was found about it."""

    @property
    def camera(self) -> CameraModel | None:
        """The camera; None where the calibration fails."""
        return self.fitted.camera if self.fitted is not None and exit_code(self.findings) == PASS else None


@dataclass(frozen=True, slots=True, eq=False)
class StitchedCalibration:
    """The lenses behind stitched shots, from boards."""

    findings: tuple[Finding, ...]
    """In the order in which they were made."""
    fit: StitchedFit | None = None
    """The correction, where there is one."""

    @property
    def camera(self) -> CameraModel | None:
        """The camera; None where the calibration fails."""
        return self.fit.camera if self.fit is not None and exit_code(self.findings) == PASS else None


def calibrate_lenses(
    folder: Path, model: str = "kannala_brandt", on_progress: Callable[[str], None] = lambda _: None
) -> LensCalibration | StitchedCalibration:
    """Find the parameters of one lens or two from shots of boards.

    Parameters
    ----------
    folder : Path
        With intrinsics.yaml and its shots or corners.
    model : str
        Name of the lens model, or ``stitched_equirectangular``.
    on_progress : callable
        Is told what is done next.

    Returns
    -------
    LensCalibration or StitchedCalibration
        With the findings; `lenses_page` shows it.

    Raises
    ------
    PalletLocError
        If the model is unknown, or a file is missing or wrong.
    """
    if model == STITCHED:
        task = _stitched_task(folder)
        return _calibrate_stitched(task, Equirectangular(*task.size), on_progress)
    if model not in MODELS:
        raise PalletLocError(f"--model {model}: unknown lens model{nearest_name(model, [*MODELS, STITCHED])}")
    task = read_intrinsics(folder)
    if task.lenses == 2 and model != "kannala_brandt":
        raise PalletLocError(f"--model {model}: a camera with two lenses needs the model kannala_brandt")
    return _calibrate(task, lens_model(model), on_progress)


def _calibrate(task: IntrinsicsTask, lens: LensModel, on_progress: Callable[[str], None]) -> LensCalibration:
    found = collect(task, on_progress)
    findings = view_findings(task, found)
    if exit_code(findings) != PASS:
        return LensCalibration(lens.name, tuple(findings), found)
    on_progress("fitting")
    fit = _fitted(task, lens, found)
    if isinstance(fit, Finding):
        return LensCalibration(lens.name, (*findings, fit), found)
    for _ in range(_MEASURED_AGAIN if found.patterns else 0):
        lenses = measuring_lenses(fit, task.size)
        if lenses is None:
            break
        poses = {view.name: fit.rig.lens_from_board(view) for view in fit.problem.views}
        found = replace(found, views=measure_again(task, found, lenses, poses, on_progress))
        on_progress("fitting")
        again = _fitted(task, lens, found)
        if isinstance(again, Finding):
            return LensCalibration(lens.name, (*findings, again), found)
        fit = again
    camera = fitted_camera(fit, task.size, task.max_angle)
    if isinstance(camera, Finding):
        return LensCalibration(lens.name, (*findings, camera), found, fit)
    checked = check_fit(fit, camera.lenses, [aperture.width for aperture in task.apertures])
    return LensCalibration(lens.name, (*findings, *checked.findings), found, fit, camera, checked)


def _fitted(task: IntrinsicsTask, lens: LensModel, found: Collected) -> LensFit | Finding:
    try:
        return fit_lenses(found.views, [lens] * task.lenses, task.apertures, _still_boards(task, found))
    except NoStartError as error:
        return _no_start(error)
    except UnlinkedError as error:
        how = "show the board in the ring that both lenses see, or let several boards stand still and say so"
        return Finding(Severity.DEGENERATE, "lenses_not_linked", str(error), how)
    except np.linalg.LinAlgError as error:
        return Finding(Severity.DEGENERATE, "unobservable", f"the boards leave the lens open: {error}", _TILT)


def _still_boards(task: IntrinsicsTask, found: Collected) -> int:
    """Return how many boards keep their places against each other; 1 where each has its own in each shot."""
    return max(view.board for view in found.views) + 1 if task.boards_stand_still else 1


def _no_start(error: NoStartError) -> Finding:
    return Finding(Severity.DEGENERATE, "no_start", str(error), "check the boards' sizes and the shots")


def _stitched_task(folder: Path) -> IntrinsicsTask:
    task = read_intrinsics(folder)
    path = folder / INTRINSICS
    if task.lenses != 1:
        raise DocumentError(f"{path}: lenses: expected no such key with --model {STITCHED}: the shots are stitched")
    plain = [name for name, board in task.boards.items() if isinstance(board, Chessboard)]
    if plain:
        raise DocumentError(f"{path}: boards.{plain[0]}: expected a ChArUco board in stitched shots")
    return replace(task, start=Equirectangular(*task.size))


def _calibrate_stitched(
    task: IntrinsicsTask, camera: Equirectangular, on_progress: Callable[[str], None]
) -> StitchedCalibration:
    found = collect(task, on_progress)
    findings = view_findings(task, found)
    if exit_code(findings) != PASS:
        return StitchedCalibration(tuple(findings))
    if found.patterns:
        poses = {view.name: pose for view in found.views if (pose := whole_pose(camera, view)) is not None}
        found = replace(found, views=measure_again(task, found, [camera], poses, on_progress))
    on_progress("fitting")
    fit = _fitted_stitched(task, camera, found)
    if isinstance(fit, Finding):
        return StitchedCalibration((*findings, fit))
    return StitchedCalibration((*findings, *check_stitched(fit)), fit)


def _fitted_stitched(task: IntrinsicsTask, camera: Equirectangular, found: Collected) -> StitchedFit | Finding:
    try:
        return fit_stitched(camera, found.views, _still_boards(task, found))
    except NoStartError as error:
        return _no_start(error)
    except UnlinkedError as error:
        return Finding(Severity.DEGENERATE, "boards_not_linked", str(error), AROUND)
    except np.linalg.LinAlgError as error:
        what = f"the boards leave the lenses open: {error}"
        return Finding(Severity.DEGENERATE, "unobservable", what, AROUND)
    except ValueError as error:
        return Finding(Severity.FAIL, "not_invertible", str(error), AROUND)
