"""The aisle from above with true pallets, estimates and the forklift's path."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from palletloc.drawing.canvas import FAINT, GRID, INK, WIDTH_PX, add_axes, add_legend, add_text, new_figure
from palletloc.evaluation.pose_error import TrueFace
from palletloc.evaluation.run import EvaluatedRun
from palletloc.evaluation.run_match import ShotMatch
from palletloc.evaluation.truth import RecordingTruth
from palletloc.geometry import FloatArray, LevelPose
from palletloc.pallet import PalletModel
from palletloc.report.source_style import STYLES

_LEFT, _RIGHT, _HEAD, _FOOT = 70, 20, 72, 92  # in pixels
_LEAST_PX, _MOST_PX, _AROUND = 300, 640, 0.5
_FALSE = "#c81e4a"


def aisle_figure(truth: RecordingTruth, run: EvaluatedRun) -> Figure:
    """Draw a map in the world frame; without a path of the forklift, in its frame at the first stop.

    Parameters
    ----------
    truth : RecordingTruth
        The truth.
    run : EvaluatedRun
        The run.

    Returns
    -------
    Figure
        True pallets as outlines with thick fronts, estimates as marks, false ones as crosses, the path as a line.
    """
    models = {model.name: model for model in truth.recording.models}
    pallets, path, carried = _world(truth, run)
    drawn = [_corners(models[model], pose) for _, model, pose in pallets]
    places = np.concatenate([path, *drawn])
    low, high = places.min(axis=0) - _AROUND, places.max(axis=0) + _AROUND
    width = WIDTH_PX - _LEFT - _RIGHT
    size = high - low
    scale = min(width / size[0], _MOST_PX / size[1])
    height = max(float(size[1] * scale), _LEAST_PX)
    spare = (np.array([width, height]) / scale - size) / 2
    figure = new_figure(_HEAD + height + _FOOT)
    add_text(figure, _LEFT, 14, f"{run.files.name}: the aisle from above", size=13, bold=True)
    add_text(figure, _LEFT, 40, "Outlines: true pallets, thick at the front. Marks: estimates", size=10.5)
    axes = add_axes(figure, _LEFT, _HEAD, width, height)
    axes.set(xlim=(low[0] - spare[0], high[0] + spare[0]), ylim=(low[1] - spare[1], high[1] + spare[1]))
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    for (name, _, pose), corners in zip(pallets, drawn, strict=True):
        axes.add_patch(Polygon(corners, facecolor="#eef1f4", edgecolor=FAINT, linewidth=0.9))
        axes.plot(*corners[:2].T, color=INK, linewidth=3.0, solid_capstyle="butt")
        middle = corners.mean(axis=0)
        told = f"{name}, {round(pose.z, 2) + 0.0:.2f} m up"
        axes.text(middle[0], middle[1], told, ha="center", va="center", size=9, parse_math=False)
    axes.plot(*path.T, color=INK, linewidth=1.2, marker=".", markersize=5, label="forklift, true")
    _draw_estimates(axes, run, carried)
    add_legend(figure, _HEAD + height + 52, axes)
    return figure


_Pallet = tuple[str, str, LevelPose]
_Carried = Mapping[float, LevelPose]


def _world(truth: RecordingTruth, run: EvaluatedRun) -> tuple[list[_Pallet], FloatArray, _Carried]:
    """Return the pallets, the forklift's places, (n, 2), and its pose at each shot's time."""
    shots = next(iter(run.sources.values())).shots
    if truth.path is not None:
        poses = {shot.time: truth.path.pose_at(shot.time) for shot in shots}
        pallets = [(one.id, one.model, one.world_from_pallet) for one in truth.pallets]
        return pallets, np.array([[pose.x, pose.y] for pose in poses.values()]), poses
    here = LevelPose(0.0, 0.0, 0.0, 0.0)
    first = shots[0]
    faces = {face.id: face for face in _faces(first)}
    pallets = [(face.id, face.model, face.forklift_from_pallet) for face in faces.values()]
    return pallets, np.zeros((1, 2)), {first.time: here}


def _faces(shot: ShotMatch) -> list[TrueFace]:
    return [*(one.face for one in (*shot.errors, *shot.beyond)), *shot.missed]


def _corners(model: PalletModel, pose: LevelPose) -> FloatArray:
    """Return the four corners from above, the front's first, (4, 2)."""
    half = model.width / 2
    corners = np.array([[0, half, 0], [0, -half, 0], [model.depth, -half, 0], [model.depth, half, 0]])
    return np.asarray(pose.transform().apply(corners)[:, :2])


def _draw_estimates(axes: Axes, run: EvaluatedRun, carried: _Carried) -> None:
    for name, source in run.sources.items():
        style = STYLES[name]
        found: list[FloatArray] = []
        false: list[FloatArray] = []
        for shot in source.shots:
            if shot.time not in carried:
                continue
            world_from_forklift = carried[shot.time].transform()
            placed = [one.estimate for one in (*shot.errors, *shot.beyond)]
            found += [world_from_forklift.apply(_place(one.forklift_from_pallet))[:2] for one in placed]
            false += [world_from_forklift.apply(_place(one.forklift_from_pallet))[:2] for one in shot.false]
        if found:
            axes.plot(*np.array(found).T, style.mark, color=style.color, markersize=4, alpha=0.6, label=style.label)
        if false:
            label = f"{style.label}: where no pallet stands"
            axes.plot(*np.array(false).T, "x", color=_FALSE, markersize=7, markeredgewidth=1.6, label=label)


def _place(pose: LevelPose) -> FloatArray:
    return np.array([pose.x, pose.y, pose.z])
