import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.axes import Axes

from palletloc.drawing.canvas import add_axes, new_figure
from palletloc.drawing.shelf_figure import Label, write_labels
from palletloc.geometry import FloatArray

POINTS = st.lists(st.tuples(st.floats(0, 10), st.floats(0, 1)), min_size=1, max_size=20)


def chart() -> Axes:
    axes = add_axes(new_figure(200), 60, 20, 1200, 150)
    axes.set(xlim=(-0.5, 10.5), ylim=(-0.2, 1.2))
    return axes


def boxes_of(axes: Axes) -> FloatArray:
    return np.array([text.get_window_extent().extents for text in axes.texts]).reshape(-1, 4)


@settings(max_examples=20, deadline=None)
@given(points=POINTS)
def test_names_cover_neither_each_other_nor_points(points: list[tuple[float, float]]) -> None:
    axes = chart()
    write_labels(axes, [Label(x, y, f"C{i}") for i, (x, y) in enumerate(points)])
    boxes = boxes_of(axes)
    low, high = boxes[:, :2], boxes[:, 2:]
    shared = np.minimum(high[:, None], high) - np.maximum(low[:, None], low)
    assert not (np.all(shared > 0, axis=-1) & ~np.eye(len(boxes), dtype=bool)).any()
    centers = axes.transData.transform(points)
    assert not ((centers[:, None] > low) & (centers[:, None] < high)).all(axis=-1).any()


def test_an_important_name_stays_where_there_is_no_room() -> None:
    axes = chart()
    crowd = [Label(5 + 0.02 * x, 0.1 * y, f"C{x}-{y}") for x in range(-9, 10) for y in range(11)]
    write_labels(axes, [*crowd, Label(5.0, 0.5, "P1", important=True)])
    written = {text.get_text() for text in axes.texts}
    assert "P1" in written
    assert len(written) < len(crowd)


def test_no_point_needs_no_name() -> None:
    axes = chart()
    write_labels(axes, [])
    assert list(axes.texts) == []
