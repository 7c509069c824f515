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
