"""Whether the texts of a figure can be read."""

import numpy as np
from matplotlib.figure import Figure

from palletloc.drawing.canvas import png
from palletloc.geometry import FloatArray


def some_overlap(boxes: FloatArray, more_than: float = 1.0) -> bool:
    """Return whether two of (n, 4) boxes overlap by more than some pixels."""
    low, high = boxes[:, :2], boxes[:, 2:]
    shared = np.minimum(high[:, None], high) - np.maximum(low[:, None], low)
    return bool((np.all(shared > more_than, axis=-1) & ~np.eye(len(boxes), dtype=bool)).any())


def require_readable(figure: Figure) -> None:
    """Check that texts beside the axes and the axes' labels lie on the page and cover no other."""
    png(figure)  # places the texts
    outside = [text for text in figure.texts if text.get_text()]
    outside += [label for axes in figure.axes for label in (axes.xaxis.label, axes.yaxis.label) if label.get_text()]
    outside += [text for legend in figure.legends for text in legend.get_texts()]
    boxes = np.array([text.get_window_extent().extents for text in outside])
    assert (boxes[:, :2] >= 0).all()
    assert (boxes[:, 2:] <= figure.get_size_inches() * figure.dpi).all()
    assert not some_overlap(boxes)
