from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.figure import Figure

from palletloc.drawing.canvas import png


@pytest.fixture(scope="session")
def require_readable() -> Callable[[Figure], None]:
    """Return a check that all texts outside the axes lie on the page and cover no other."""

    def check(figure: Figure) -> None:
        png(figure)  # places the texts
        width, height = figure.get_size_inches() * figure.dpi
        outside = [text for text in figure.texts if text.get_text()]
        outside += [
            label for axes in figure.axes for label in (axes.xaxis.label, axes.yaxis.label) if label.get_text()
        ]
        outside += [text for legend in figure.legends for text in legend.get_texts()]
        boxes = np.array([text.get_window_extent().extents for text in outside])
        low, high = boxes[:, :2], boxes[:, 2:]
        assert (low >= 0).all()
        assert (high <= (width, height)).all()
        shared = np.minimum(high[:, None], high) - np.maximum(low[:, None], low)
        assert not (np.all(shared > 1.0, axis=-1) & ~np.eye(len(boxes), dtype=bool)).any()

    return check
