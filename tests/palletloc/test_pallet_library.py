import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from palletloc import Opening, PalletLocError, PalletModel, find_models, load_library
from palletloc.pallet_library import format_pallets, read_pallets
from tests.palletloc.poses import WritePallets

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared/data"
LIBRARY = load_library()
FACE = "width_m: 1.1, height_m: 0.144, depth_m: 0.9"
OPENING = "{center_m: 0.1, bottom_m: 0.02, width_m: 0.3, height_m: 0.1}"
POCKETS = "{pocket_width_m: 0.3, center_width_m: 0.2, pocket_bottom_m: 0, pocket_height_m: 0.1}"
GOOD = f"mine: {{{FACE}, openings: [{OPENING}]}}\n"


def millimetres(model: PalletModel) -> list[float]:
    """Return the chain of blocks and openings."""
    cuts = [side for block in model.blocks for side in block]
    return [round((right - left) * 1000, 1) for left, right in pairwise(cuts)]


# The library: dimensions as published, in millimetres.


def test_both_faces_of_an_epal_1_have_the_published_parts() -> None:
    model = LIBRARY["epal1-1200"]
    assert millimetres(model) == [145, 382.5, 145, 382.5, 145]
    assert (model.height, model.depth) == (0.144, 0.8)
    levels = {(opening.bottom, round(opening.top, 6), opening.open_below) for opening in model.openings}
    assert levels == {(0.022, 0.122, False)}
    model = LIBRARY["epal1-800"]
    assert millimetres(model) == [100, 227.5, 145, 227.5, 100]
    assert (model.height, model.depth) == (0.144, 1.2)
    levels = {(opening.bottom, opening.top, opening.open_below) for opening in model.openings}
    assert levels == {(0.0, 0.1, True)}


def test_each_face_of_an_epal_1_has_the_published_blocks_behind_it_those_of_the_other() -> None:
    blocks = {"epal1-1200": [100, 227.5, 145, 227.5, 100], "epal1-800": [145, 382.5, 145, 382.5, 145]}
    for name, chain in blocks.items():
        cuts = [cut for row in LIBRARY[name].block_rows for cut in row]
        assert [round((back - front) * 1000, 1) for front, back in pairwise(cuts)] == chain
        assert cuts[-1] == LIBRARY[name].depth
    for name, other in (("epal1-1200", "epal1-800"), ("epal1-800", "epal1-1200")):
        half = LIBRARY[other].width / 2
        assert np.allclose(
            LIBRARY[name].block_rows, [(left + half, right + half) for left, right in LIBRARY[other].blocks]
        )


def test_a_t11_and_a_gma_pallet_have_the_levels_of_their_standards() -> None:
    model = LIBRARY["t11"]
    assert (model.width, model.height, model.depth) == (1.1, 0.144, 1.1)
    assert {(opening.bottom, opening.height) for opening in model.openings} == {(0.022, 0.1)}
    inch, model = 0.0254, LIBRARY["gma-1016"]
    assert [right - left for left, right in model.blocks] == pytest.approx([1.375 * inch] * 3, abs=2e-4)
    assert model.height == pytest.approx((3.5 + 2 * 0.625) * inch, abs=2e-4)
    assert [opening.height for opening in model.openings] == pytest.approx([3.5 * inch] * 2, abs=2e-4)


@pytest.mark.parametrize(("name", "window"), [("chep-us-1219", (370, 90)), ("chep-us-1016", (318, 106))])
def test_the_windows_of_a_chep_pallet_are_as_published(name: str, window: tuple[int, int]) -> None:
    sizes = {(opening.width * 1000, opening.height * 1000) for opening in LIBRARY[name].openings}
    assert sizes == {window}


def test_the_example_is_the_pallet_of_the_recordings() -> None:
    path = SHARED / "dev_lab/pallets.yaml"
    if not path.is_file():
        pytest.skip("the recordings are not here")
    assert replace(LIBRARY["t11-plastic"], source="", note="") == read_pallets(path)["t11-plastic"]


def test_every_face_is_symmetric_and_says_where_it_comes_from_and_what_is_assumed() -> None:
    for model in LIBRARY.values():
        mirrored = [replace(opening, center=-opening.center) for opening in reversed(model.openings)]
        assert tuple(mirrored) == model.openings
    for model in LIBRARY.values():
        assert model.source
        assert model.confirmed or model.note
        assert model.edge_radius > 0


def test_the_two_faces_of_a_pallet_fit_together() -> None:
    faces: dict[str, list[PalletModel]] = {}
    for name, model in LIBRARY.items():
        if re.search(r"-\d+$", name):
            assert name.endswith(f"-{round(model.width * 1000)}")
            faces.setdefault(name.rpartition("-")[0], []).append(model)
    pairs = [pair for pair in faces.values() if len(pair) == 2]
    assert len(pairs) >= 5
    for face, other in pairs:
        assert (face.width, face.depth, face.height) == (other.depth, other.width, other.height)


def test_the_page_lists_every_model_with_its_status() -> None:
    page = (ROOT / "docs/pallets.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w.-]+)` \| (.+?) \| (.+?) \| (.+?) \|", page, re.MULTILINE)
    listed = {row[0]: row[1:] for row in rows if row[0] in LIBRARY}
    assert list(listed) == list(LIBRARY)
    for name, (face, openings, status) in listed.items():
        model, first = LIBRARY[name], LIBRARY[name].openings[0]
        assert face == f"{model.width * 1000:g} x {model.height * 1000:g}"
        level = ", open at the floor" if first.open_below else f" from {first.bottom * 1000:g} up"
        assert openings == f"{first.width * 1000:g} x {first.height * 1000:g}{level}"
        assert (status == "confirmed") is model.confirmed


def test_models_come_once_in_the_order_of_the_names_the_users_first_and_may_be_changed() -> None:
    load_library().clear()
    assert load_library() == LIBRARY
    names = ["t11", "epal1-800", "cp9"]
    assert [model.name for model in find_models(names, {})] == names
    assert find_models(["t11", "cp9", "t11"], {}) == (LIBRARY["t11"], LIBRARY["cp9"])
    mine = replace(LIBRARY["cp9"], name="t11")
    assert find_models(["t11"], {"t11": mine}) == (mine,)
    assert find_models(["t11"], {}) == (LIBRARY["t11"],)


# Finding models by name.


@pytest.mark.parametrize(("name", "nearest"), [("t11-plastik", "t11-plastic"), ("my-palet", "my-pallet")])
def test_an_unknown_name_gives_the_nearest(name: str, nearest: str) -> None:
    user = {"my-pallet": replace(LIBRARY["t11"], name="my-pallet")}
    with pytest.raises(PalletLocError, match=f"^unknown pallet model '{name}'; did you mean '{nearest}'\\?$"):
        find_models(["t11", name], user)


# The form of the file.


def test_a_file_may_leave_out_keys_begin_with_a_mark_and_be_named_by_text(pallet_file: WritePallets) -> None:
    opening = Opening(center=0.1, bottom=0.02, width=0.3, height=0.1)
    expected = PalletModel("mine", width=1.1, height=0.144, depth=0.9, openings=(opening,))
    assert read_pallets(pallet_file(GOOD)) == {"mine": expected}
    assert list(read_pallets(str(pallet_file(GOOD)))) == ["mine"]
    assert list(read_pallets(pallet_file(b"\xef\xbb\xbf" + GOOD.encode()))) == ["mine"]


def test_pockets_are_openings_beside_the_middle_block(pallet_file: WritePallets) -> None:
    model = read_pallets(pallet_file(f"mine: {{{FACE}, parametric: {POCKETS}}}"))["mine"]
    assert model.openings == (Opening(-0.25, 0.0, 0.3, 0.1), Opening(0.25, 0.0, 0.3, 0.1))
    assert millimetres(model) == [150, 300, 200, 300, 150]


@pytest.mark.parametrize("number", ["9e-1", "0.9", ".9", "+0.9"])
def test_a_number_is_a_number_however_it_is_written(pallet_file: WritePallets, number: str) -> None:
    content = GOOD.replace("depth_m: 0.9", f"depth_m: {number}")
    assert read_pallets(pallet_file(content))["mine"].depth == 0.9


def test_an_anchor_repeats_a_value(pallet_file: WritePallets) -> None:
    text = f"one: &one {{{FACE}, openings: [{OPENING}]}}\ntwo: {{<<: *one, depth_m: 2}}\n"
    models = read_pallets(pallet_file(text))
    assert replace(models["one"], name="two", depth=2.0) == models["two"]


lengths = st.floats(0.01, 1.0)


@st.composite
def any_model(draw: st.DrawFn) -> PalletModel:
    blocks = draw(st.lists(lengths, min_size=2, max_size=4))
    openings, left, width = [], -2.5, 5.0
    for block in blocks[:-1]:
        size, bottom = draw(st.floats(0.05, 0.5)), draw(st.sampled_from([0.0, 0.022, 0.1]))
        openings.append(Opening(left + block + size / 2, bottom, size, 0.05, draw(st.floats(0.0, 0.02))))
        left += block + size
    name = draw(st.from_regex(r"[a-zA-Z_][\w.-]{0,8}", fullmatch=True))
    cuts = [0.0, *sorted(draw(st.lists(st.floats(0.01, 0.99), min_size=1, max_size=5, unique=True)))]
    depth = draw(lengths)
    texts = st.text(st.characters(codec="utf-8", exclude_categories=["C"]))
    return PalletModel(
        f"{name}x",  # never a word of YAML's own, such as `no`
        width,
        draw(st.floats(0.16, 2.0)),
        depth,
        tuple(openings),
        corner_radius=draw(st.floats(0.0, 0.05)),
        edge_radius=draw(st.floats(0.0, 0.003)),
        tolerance=draw(st.floats(1e-6, 0.1)),
        source=draw(texts),
        confirmed=draw(st.booleans()),
        note=draw(texts),
        block_rows=tuple((front * depth, back * depth) for front, back in zip(cuts[::2], cuts[1::2], strict=False)),
    )


@settings(max_examples=settings().max_examples // 3)
@given(model=any_model())
def test_what_is_written_is_read_back_unchanged(model: PalletModel, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.getbasetemp() / "pallets.yaml"
    path.write_text(format_pallets([model]), encoding="utf-8")
    assert read_pallets(path) == {model.name: model}


def test_the_library_is_written_as_the_contract_says_and_read_back(pallet_file: WritePallets) -> None:
    assert read_pallets(pallet_file(format_pallets(LIBRARY.values()))) == LIBRARY
    written = yaml.safe_load(format_pallets([LIBRARY["t11-plastic"]]))["t11-plastic"]
    assert {"width_m", "height_m", "depth_m", "corner_radius_m", "edge_radius_m", "openings"} <= set(written)
    assert set(written["openings"][0]) == {"center_m", "bottom_m", "width_m", "height_m", "radius_m"}
