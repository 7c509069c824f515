import io
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from matplotlib import pyplot as plt
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from palletloc import Opening, PalletModel, load_library
from palletloc.drawing.pallets import pallets_figure, pallets_png
from palletloc.geometry import BoolArray
from tests.palletloc.drawing.readable import some_overlap

LIBRARY = load_library()
CLOSED = LIBRARY["epal1-1200"]
OPEN = LIBRARY["epal1-800"]
ODD = PalletModel(
    "odd",
    width=0.5,
    height=0.4,
    depth=0.6,
    openings=(Opening(-0.1, 0.0, 0.1, 0.2, radius=0.04), Opening(0.1, 0.05, 0.15, 0.3, radius=0.03)),
    corner_radius=0.05,
    note="costs $5 and a_b " * 40,
)


@pytest.fixture(scope="module")
def library_figure() -> Figure:
    return pallets_figure(list(LIBRARY.values()))


def faces(figure: Figure) -> list[FancyBboxPatch]:
    """Return the outlines: the boxes that have an edge."""
    boxes = [patch for patch in figure.axes[0].patches if isinstance(patch, FancyBboxPatch)]
    return [box for box in boxes if to_rgba(box.get_edgecolor())[3] > 0]


def pixels_of(model: PalletModel) -> tuple[BoolArray, BoolArray]:
    """Return which pixels show solid wood, and which an opening."""
    figure = pallets_figure([model])
    buffer = io.BytesIO()
    figure.savefig(buffer, format="rgba")
    width, height = figure.canvas.get_width_height()
    rgb = np.frombuffer(buffer.getvalue(), np.uint8).reshape(height, width, 4)[..., :3] / 255
    fill = to_rgb(faces(figure)[0].get_facecolor())
    openings = [patch for patch in figure.axes[0].patches if patch not in faces(figure)]
    dark = to_rgb(openings[0].get_facecolor())
    solid, hole = (np.all(np.abs(rgb - color) < 0.02, axis=-1) for color in (fill, dark))
    return solid, hole


def require_inside(figure: Figure) -> None:
    page = figure.bbox
    for artist in (*figure.axes[0].texts, *figure.axes[0].patches, *figure.axes[0].lines):
        box = artist.get_window_extent()
        assert page.x0 <= box.x0 <= box.x1 <= page.x1
        assert page.y0 <= box.y0 <= box.y1 <= page.y1


def test_all_faces_have_one_scale_and_pixels_are_square(library_figure: Figure) -> None:
    drawn = faces(library_figure)
    scales = [
        size / length
        for box, model in zip(drawn, LIBRARY.values(), strict=True)
        for size, length in ((box.get_width(), model.width), (box.get_height(), model.height))
    ]
    assert scales == pytest.approx([scales[0]] * len(scales))
    figure = pallets_figure([CLOSED])
    x, y = figure.axes[0].transData.transform([[0.0, 0.0], [1.0, 1.0]]).T
    assert np.diff(x) == pytest.approx(np.diff(y))


@pytest.mark.parametrize("model", [CLOSED, OPEN, LIBRARY["t11"], LIBRARY["gma-1219"]], ids=lambda m: m.name)
def test_the_picture_has_as_much_opening_as_the_model(model: PalletModel) -> None:
    solid, hole = pixels_of(model)
    openings = sum(opening.width * opening.height for opening in model.openings)
    share = openings / (model.width * model.height)
    assert hole.sum() / (hole.sum() + solid.sum()) == pytest.approx(share, rel=0.05)


@pytest.mark.parametrize("model", [OPEN, ODD], ids=lambda m: m.name)
def test_no_edge_crosses_an_opening_at_the_floor(model: PalletModel) -> None:
    solid, hole = pixels_of(model)
    column = int(np.flatnonzero(hole.any(axis=0))[0]) + 20  # within the first opening, which is open
    assert np.flatnonzero(hole[:, column])[-1] >= np.flatnonzero(solid.any(axis=1))[-1]


def test_an_opening_ends_at_the_floor_and_a_bottom_board_lies_below_a_closed_one() -> None:
    # the first opening of the odd one has corners that would lie below
    for model, below in ((ODD, 3), (CLOSED, -1)):
        solid, hole = pixels_of(model)
        assert np.flatnonzero(hole.any(axis=1))[-1] <= np.flatnonzero(solid.any(axis=1))[-1] + below


def test_every_model_has_its_name_and_its_mark_that_changes_with_the_status_as_the_outline_does(
    library_figure: Figure,
) -> None:
    texts = Counter(text.get_text() for text in library_figure.axes[0].texts)
    assert [texts[name] for name in LIBRARY] == [1] * len(LIBRARY)
    confirmed = sum(model.confirmed for model in LIBRARY.values())
    assert (texts["confirmed"], texts["unconfirmed"]) == (confirmed, len(LIBRARY) - confirmed)
    doubtful = pallets_figure([replace(CLOSED, confirmed=False)])
    sure = pallets_figure([replace(CLOSED, confirmed=True)])
    assert faces(doubtful)[0].get_linestyle() != faces(sure)[0].get_linestyle()
    assert "unconfirmed" in [text.get_text() for text in doubtful.axes[0].texts]


def test_dimensions_are_in_millimetres_and_a_dollar_sign_begins_no_formula() -> None:
    texts = Counter(text.get_text() for text in pallets_figure([CLOSED]).axes[0].texts)
    assert (texts["145"], texts["382.5"]) == (3, 2)  # the chain across the face
    assert (texts["22"], texts["100"], texts["144"]) == (2, 1, 1)  # the levels, and the whole height
    (note,) = (text for text in pallets_figure([ODD]).axes[0].texts if "$" in text.get_text())
    assert not note.get_parse_math()


def test_nothing_leaves_the_page(library_figure: Figure) -> None:
    huge = replace(CLOSED, width=9.0, height=3.0)
    for models in ([ODD], [CLOSED, OPEN], [CLOSED, OPEN, ODD], [huge]):
        require_inside(pallets_figure(models))
    require_inside(library_figure)


def test_no_text_covers_another(library_figure: Figure) -> None:
    texts = [text for text in library_figure.axes[0].texts if text.get_text()]
    assert not some_overlap(np.array([text.get_window_extent().extents for text in texts]), 1.5)


def test_the_page_has_room_for_the_highest_face_wherever_it_stands_and_stays_a_page_for_a_huge_one() -> None:
    first, last = pallets_figure([ODD, CLOSED, OPEN]), pallets_figure([CLOSED, OPEN, ODD])
    assert tuple(first.get_size_inches()) == tuple(last.get_size_inches())
    huge = replace(CLOSED, width=10.0, depth=10.0)
    assert max(pallets_figure([huge, CLOSED, OPEN]).get_size_inches()) < 20


def test_columns_are_filled_row_by_row() -> None:
    corners = [(box.get_x(), box.get_y()) for box in faces(pallets_figure([OPEN] * 5, columns=2))]
    assert len({round(x, 6) for x, _ in corners}) == 2
    assert corners == sorted(corners, key=lambda corner: (-corner[1], corner[0]))


def test_something_is_drawn_somewhere_and_leaves_no_figure_open() -> None:
    for models, columns in (([], 3), ([OPEN], 0)):
        with pytest.raises(ValueError, match="expected models and at least one column"):
            pallets_figure(models, columns)
    assert pallets_png([OPEN]).startswith(b"\x89PNG\r\n\x1a\n")
    assert plt.get_fignums() == []
