"""The tables of the consistency study."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from benchmarks.tables import Column, Section, Value
from benchmarks.views import HeightClass, ShotViews, View
from palletloc.choices import Method
from palletloc.evaluation.pose_error import PoseError

_CHI2_4 = "NEES as mean / median / 95 %; a covariance that tells the truth gives 4.0 / 3.4 / 9.5"
_DEGREE, _METRE = float(np.degrees(1)), 1e3
_EXACT_MODEL = 0.005

_CLASS_COLUMNS = (
    Column("pallets"),
    Column("images"),
    Column("views"),
    Column("recall", 3),
    Column("refused", 3),
    Column("false/shot", 2),
    Column("yaw deg", 2),
    Column("depth mm"),
    Column("along mm"),
    Column("NEES", 1),
)
_FACTOR_COLUMNS = (
    Column("what"),
    Column("value"),
    Column("floor: views"),
    Column("recall", 3),
    Column("yaw deg", 2),
    Column("NEES", 1),
    Column("other heights: views"),
    Column("their recall", 3),
    Column("their yaw deg", 2),
    Column("their NEES", 1),
)


def class_table(method: Method, shots: Sequence[ShotViews], span: str) -> Section:
    """Return errors and covariances by the pallets' heights and the images' sizes.

    Parameters
    ----------
    method : Method
        What measured them.
    shots : sequence of ShotViews
        What it made of every shot.
    span : str
        Which scenes they are of.
    """
    rows = [
        _class_row(height, full, [shot for shot in shots if shot.full is full])
        for height in HeightClass
        for full in (True, False)
    ]
    note = f"{span}; errors as median / 95 % / largest of the absolute values. {_CHI2_4}."
    return Section(f"Consistency of {method}", _CLASS_COLUMNS, tuple(row for row in rows if row), note)


def _class_row(height: HeightClass, full: bool, shots: Sequence[ShotViews]) -> tuple[Value, ...]:
    views = [view for shot in shots for view in shot.views if view.height is height]
    false = sum(found is height for shot in shots for found in shot.false)
    if not views and not false:
        return ()
    errors = _errors(views)
    return (
        str(height),
        "full size" if full else "half size",
        len(views),
        _share(view.error is not None for view in views),
        _share(view.refused for view in views),
        false / len(shots),
        _spread([error.yaw * _DEGREE for error in errors]),
        _spread([error.depth * _METRE for error in errors]),
        _spread([error.along * _METRE for error in errors]),
        _nees(errors),
    )


FACTORS: dict[str, Callable[[View], str]] = {
    "images": lambda view: "full size" if view.scene.full else "half size",
    "camera": lambda view: str(view.scene.spec.camera),
    "model": lambda view: view.face.model,
    "tolerance": lambda view: "1 mm" if _tolerance(view) < _EXACT_MODEL else "6 mm and more",
    "misfit": lambda view: _bin(view.scene.spec.aisle.misfit, (0.0, 0.5, 1.0, 1.5)),
    "light": lambda view: str(view.scene.spec.aisle.light),
    "gain": lambda view: _bin(view.scene.spec.sensor.gain, (0.25, 0.7, 1.5, 3.0)),
    "blur px": lambda view: _bin(view.scene.spec.sensor.blur_px, (0.4, 0.8, 1.2, 1.5)),
    "noise": lambda view: _bin(view.scene.spec.sensor.noise, (0.5, 1.2, 2.8, 6.0)),
    "hidden": lambda view: _bin(view.hidden, (0.0, 0.02, 0.2, 0.5)),
    "gloss": lambda view: _bin(view.scene.spec.aisle.gloss, (0.0, 0.1, 0.35, 0.6)),
    "floor line": lambda view: "yes" if view.scene.spec.aisle.lines else "no",
    "range m": lambda view: _bin(view.face.range, (0.0, 2.0, 3.0, 4.0, 4.5)),
    "mounting deg": lambda view: _mounting(view.scene.spec.mounting_rotation_sigma),
    "taken for": lambda view: _taken_for(view.error),
}
"""What the second table splits the views by."""


def _tolerance(view: View) -> float:
    return next(model.tolerance for model in view.scene.spec.aisle.models if model.name == view.face.model)


def _mounting(rotation_sigma: float) -> str:
    return _bin(float(np.degrees(rotation_sigma)), (0.01, 0.04, 0.12)) if rotation_sigma else "exact"


def _taken_for(error: PoseError | None) -> str:
    if error is None:
        return "nothing"
    return "its model" if error.same_model else "another model"


def factor_table(method: Method, shots: Sequence[ShotViews]) -> Section:
    """Return covariances by what was drawn, to see where they do not tell the truth.

    Parameters
    ----------
    method : Method
        What measured them.
    shots : sequence of ShotViews
        What it made of every shot.
    """
    views = [view for shot in shots for view in shot.views]
    rows = []
    for name, value_of in FACTORS.items():
        by_value: dict[str, list[View]] = {}
        for view in views:
            by_value.setdefault(value_of(view), []).append(view)
        rows += [_factor_row(name, value, by_value[value]) for value in sorted(by_value)]
    note = f"Yaw as median / 95 % of the absolute values. {_CHI2_4}."
    return Section(f"Covariances of {method} by what was drawn", _FACTOR_COLUMNS, tuple(rows), note)


def _factor_row(name: str, value: str, views: Sequence[View]) -> tuple[Value, ...]:
    low = [view for view in views if view.height is HeightClass.FLOOR]
    high = [view for view in views if view.height is not HeightClass.FLOOR]
    return (name, value, *_half_row(low), *_half_row(high))


def _half_row(views: Sequence[View]) -> tuple[Value, ...]:
    errors = _errors(views)
    yaw = _spread([error.yaw * _DEGREE for error in errors])
    recall = _share(view.error is not None for view in views)
    return len(views), recall, yaw and yaw[:2], _nees(errors)


def _bin(value: float, edges: Sequence[float]) -> str:
    """Return the part between two edges that a value lies in; the labels sort as the parts do."""
    place = int(np.clip(np.searchsorted(edges, value, side="right"), 1, len(edges) - 1))
    return f"{edges[place - 1]:g} to {edges[place]:g}"


def _errors(views: Iterable[View]) -> list[PoseError]:
    return [view.error for view in views if view.error is not None]


def _share(truths: Iterable[bool]) -> float | None:
    truths = list(truths)
    return sum(truths) / len(truths) if truths else None


def _spread(values: Sequence[float]) -> tuple[float, ...] | None:
    """Return median, 95th percentile and maximum of absolute values."""
    if not values:
        return None
    size = np.abs(values)
    return float(np.median(size)), float(np.percentile(size, 95)), float(size.max())


def _nees(errors: Sequence[PoseError]) -> tuple[float, ...] | None:
    """Return mean, median and 95th percentile."""
    if not errors:
        return None
    squared = [error.nees for error in errors]
    return float(np.mean(squared)), float(np.median(squared)), float(np.percentile(squared, 95))
