import re

import pytest

from palletloc.report.page import Column, commands, heading, key_figures, listing, page, paragraph, picture, table

NASTY = '<b>"quoted" & $dollar</b>'
SAFE = "&lt;b&gt;&quot;quoted&quot; &amp; $dollar&lt;/b&gt;"


def test_texts_are_never_taken_for_html() -> None:
    parts = [
        heading(NASTY),
        paragraph(NASTY),
        key_figures([(NASTY, NASTY)]),
        picture("a.png", NASTY),
        table([Column(NASTY)], [[NASTY]]),
        listing([(NASTY, NASTY)]),
        commands([NASTY]),
    ]
    for part in parts:
        assert "<b>&quot" not in part
        assert '<b>"quoted' not in part
        assert SAFE in part
    assert f"<title>{SAFE}</title>" in page(NASTY, parts)


def test_a_page_holds_its_parts_in_order() -> None:
    whole = page("t", [paragraph("first"), paragraph("second")])
    assert whole.index("first") < whole.index("second")
    assert whole.count("<html") == whole.count("</html>") == 1


def test_a_table_has_a_cell_for_each_column_and_row() -> None:
    text = table([Column("name", is_text=True), Column("mm")], [["A", "1"], ["B", "2"], ["C", "3"]])
    assert (text.count("<th"), text.count("<td")) == (1 + 2, 6)  # the head itself begins with <th, too
    assert text.count('class="text"') == 1 + 3


def test_a_wide_picture_scrolls() -> None:
    assert 'class="wide"' in picture("a.png", "c", keep_wide=True)
    assert 'class="wide"' not in picture("a.png", "c")


STYLE = page("t", []).partition("<style>")[2].partition("</style>")[0]
LIGHT, DARK = (
    dict(re.findall(r"--(\w+): (#[0-9a-f]+)", block)) for block in re.findall(r":root \{(.*?)\}", STYLE, re.DOTALL)
)


def luminance(color: str) -> float:
    """Return the relative luminance of WCAG 2.2."""
    digits = color[1:] if len(color) == 7 else "".join(2 * digit for digit in color[1:])
    channels = [int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4)]
    linear = [value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4 for value in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(first: str, second: str) -> float:
    low, high = sorted((luminance(first), luminance(second)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("colors", [LIGHT, DARK], ids=["light", "dark"])
@pytest.mark.parametrize("text", ["ink", "faint", "link"])
@pytest.mark.parametrize("paper", ["paper", "soft"])
def test_texts_can_be_read_in_light_and_in_dark(colors: dict[str, str], text: str, paper: str) -> None:
    assert contrast(colors[text], colors[paper]) >= 4.5  # WCAG 2.2, 1.4.3, for texts of usual size


def test_dark_changes_every_color_and_nothing_has_a_color_of_its_own() -> None:
    assert "@media (prefers-color-scheme: dark)" in STYLE
    assert set(LIGHT) == set(DARK)
    assert luminance(DARK["paper"]) < 0.05 < 0.9 < luminance(LIGHT["paper"])
    rules = re.sub(r":root \{.*?\}", "", STYLE, flags=re.DOTALL)
    assert re.findall(r"(\w+) \{[^}]*#[0-9a-f]{3,6}", rules) == ["img"]  # figures have white paper wherever they are


def test_nothing_is_wider_than_a_phone_but_what_scrolls_in_a_box_of_its_own() -> None:
    rules = re.findall(r"([^{}]+)\{([^{}]*)\}", STYLE)
    wide = {
        selector.strip()
        for selector, body in rules
        for size in re.findall(r"(?:^|[ ;(])(?:min-)?width: (\d+)px", body)
        if int(size) > 350
    }
    assert wide == {".wide img"}
    styles = {selector.strip(): body for selector, body in rules}
    assert "overflow-x: auto" in styles[".wide"]
    assert "overflow-x: auto" in styles["pre"]
    assert "max-width: 100%" in styles["img"]
    assert "overflow-wrap: anywhere" in styles["body"]  # long names and paths
    assert re.search(r"minmax\(min\(\d+px, 100%\), 1fr\)", styles[".tiles"])
    assert 'name="viewport"' in page("t", [])
    assert table([Column("a")], [["1"]]).startswith('<div class="wide"><table>')
