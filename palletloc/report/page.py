"""A page of HTML that needs nothing but itself and the pictures beside it."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from string import Template

_PAGE = Template("""\
<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
$style
</style>
</head>
<body>
<main>
$body
</main>
</body>
</html>
""")
"""The page, without its title, style and body."""
_STYLE = """\
:root { color-scheme: light dark; --paper: #fff; --ink: #22262b; --faint: #5b6470; --line: #d9dde3; --soft: #f4f6f8;
  --link: #0b5cad; --found: #15803d; --picture: none; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #15181c; --ink: #e4e7eb; --faint: #a4adb8; --line: #3a414a; --soft: #20252b;
    --link: #7ab8f5; --found: #4ade80; --picture: brightness(0.86); }
}
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); overflow-wrap: anywhere;
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 1040px; margin: 0 auto; padding: 40px 20px 64px; }
h1 { font-size: 2rem; line-height: 1.2; margin: 0 0 12px; letter-spacing: -0.01em; }
h2 { font-size: 1.3rem; margin: 48px 0 10px; letter-spacing: -0.005em; }
p { max-width: 46em; margin: 0 0 14px; }
.lead { font-size: 1.12rem; color: var(--faint); }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 12px; margin: 24px 0; }
.figures div { background: var(--soft); border-radius: 8px; padding: 14px 16px; }
.figures b { display: block; font-size: 1.6rem; line-height: 1.2; font-variant-numeric: tabular-nums; }
.figures span { color: var(--faint); font-size: 0.92rem; }
a { color: var(--link); }
figure { margin: 22px 0; }
img { display: block; max-width: 100%; height: auto; background: #fff; filter: var(--picture); }
figure img { width: 100%; border: 1px solid var(--line); border-radius: 8px; }
details { margin: 0 0 26px; border-left: 3px solid var(--line); padding-left: 16px; }
summary { cursor: pointer; color: var(--faint); }
figcaption { color: var(--faint); font-size: 0.95rem; margin-top: 8px; max-width: 52em; }
.wide { overflow-x: auto; }
.wide img { min-width: 680px; max-width: none; }
.wide + p { margin-top: 18px; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 0.95rem; width: 100%; }
th, td { padding: 6px 12px 6px 0; text-align: right; white-space: nowrap; border-bottom: 1px solid var(--line); }
th { color: var(--faint); font-weight: 600; vertical-align: bottom; }
th.text, td.text { text-align: left; }
td.wraps { white-space: normal; overflow-wrap: normal; min-width: 14em; }
th.text:last-child, td.text:last-child { padding-left: 12px; }
code { font: 0.92em/1.5 ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; }
pre { background: var(--soft); border-radius: 8px; padding: 14px 16px; overflow-x: auto; margin: 14px 0; }
.tiles { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(300px, 100%), 1fr)); gap: 20px; }
.tiles figure { margin: 0; }
.tiles pre { padding: 8px 10px; margin: 8px 0 0; font-size: 0.8rem; }
.tiles b { display: block; color: var(--ink); }
.plan { display: block; width: 100%; height: auto; max-height: 640px; background: var(--soft); border-radius: 8px; }
.plan path, .plan circle { fill: none; stroke-width: 1; vector-effect: non-scaling-stroke; }
.plan .grid { stroke: var(--line); }
.plan .shelf { stroke: var(--faint); stroke-dasharray: 8 5; }
.plan .path { stroke: var(--faint); }
.plan circle { fill: var(--ink); }
.plan .pallet { fill: var(--found); fill-opacity: 0.08; stroke: var(--found); stroke-opacity: 0.5; }
.plan .front { stroke: var(--found); stroke-width: 2.5; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: 4px 20px; }
dd { margin: 0; color: var(--faint); }
@media (max-width: 560px) {
  main { padding-top: 24px; }
  h1 { font-size: 1.6rem; }
  dl { grid-template-columns: 1fr; }
  dd { margin-bottom: 10px; }
}"""
"""Its style: one column that narrow screens can show, too, in the reader's choice of light or dark.

Pictures keep their white paper, a little darker where all around them is dark.
"""


@dataclass(frozen=True, slots=True)
class Link:
    """A cell of a table that leads to another page."""

    text: str
    """What stands there."""
    target: str
    """The page, relative to this one."""


Cell = str | Link
"""What stands in a cell: plain text or a link."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table."""

    heading: str
    """What stands above it."""
    is_text: bool = False
    """Whether its cells are words, which stand at the left, and not numbers."""
    wraps: bool = False
    """Whether its cells are sentences, which may take several lines."""

    @property
    def kind(self) -> str:
        """Attribute of its cells."""
        kinds = [name for name, holds in (("text", self.is_text), ("wraps", self.wraps)) if holds]
        return f' class="{" ".join(kinds)}"' if kinds else ""


@dataclass(frozen=True, slots=True)
class Tile:
    """A small picture among others, with what belongs to it."""

    source: str
    """The picture, relative to the page; empty where there is none."""
    name: str
    """What it is of."""
    text: str
    """What it shows."""
    command: str
    """What shows more."""


def page(title: str, parts: Iterable[str]) -> str:
    """Return a whole page: its title as plain text, and parts in HTML as the other functions here return it."""
    return _PAGE.substitute(title=escape(title), style=_STYLE, body="\n".join(parts))


def heading(text: str, level: int = 2) -> str:
    """Return a heading of plain text."""
    return f"<h{level}>{escape(text)}</h{level}>"


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph of plain text; ``kind`` is a class of the page's style."""
    attribute = f' class="{escape(kind)}"' if kind else ""
    return f"<p{attribute}>{escape(text)}</p>"


def key_figures(figures: Iterable[tuple[str, str]]) -> str:
    """Return large numbers side by side: each with what it means."""
    cells = (f"<div><b>{escape(value)}</b><span>{escape(meaning)}</span></div>" for value, meaning in figures)
    return f'<div class="figures">{"".join(cells)}</div>'


def picture(source: str, caption: str, *, keep_wide: bool = False) -> str:
    """Return a picture with its caption in plain text, which is also what is read aloud.

    A narrow screen scrolls one that keeps wide instead of making its texts unreadable.
    """
    text = escape(caption)
    image = f'<img src="{escape(source)}" alt="{text}" loading="lazy">'
    if keep_wide:
        image = f'<div class="wide">{image}</div>'
    return f"<figure>{image}<figcaption>{text}</figcaption></figure>"


def drawing(svg: str, caption: str) -> str:
    """Return a drawing, an ``svg`` element, with its caption in plain text."""
    return f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>"


def gallery(tiles: Iterable[Tile]) -> str:
    """Return small pictures side by side, as many as there is room for."""
    return "\n".join(['<div class="tiles">', *(_tile(tile) for tile in tiles), "</div>"])


def _tile(tile: Tile) -> str:
    source, name = escape(tile.source), escape(tile.name)
    image = f'<a href="{source}"><img src="{source}" alt="{name}" loading="lazy"></a>' if source else ""
    text = f"<figcaption><b>{name}</b>{escape(tile.text)}</figcaption>"
    return f"<figure>{image}{text}<pre><code>{escape(tile.command)}</code></pre></figure>"


def folded(summary: str, parts: Iterable[str], *, is_open: bool = False) -> str:
    """Return parts of a page that a click on a line of plain text shows and hides."""
    attribute = " open" if is_open else ""
    return f"<details{attribute}><summary>{escape(summary)}</summary>\n{''.join(parts)}\n</details>"


def embedded(content: bytes, kind: str = "png") -> str:
    """Return a source for `picture` that holds the picture itself: a file's content, ``png`` or ``jpeg``."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}"


def table(columns: Sequence[Column], rows: Iterable[Sequence[Cell]]) -> str:
    """Return a table, which a narrow screen scrolls."""
    kinds = [column.kind for column in columns]
    head = "".join(f"<th{kind}>{escape(column.heading)}</th>" for kind, column in zip(kinds, columns, strict=True))
    body = "\n".join(
        "<tr>" + "".join(f"<td{kind}>{_cell(cell)}</td>" for kind, cell in zip(kinds, row, strict=True)) + "</tr>"
        for row in rows
    )
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>'


def _cell(cell: Cell) -> str:
    if isinstance(cell, Link):
        return f'<a href="{escape(cell.target)}">{escape(cell.text)}</a>'
    return escape(cell)


def listing(entries: Iterable[tuple[Cell, str]]) -> str:
    """Return names, or links, with what they mean."""
    items = (f"<dt><code>{_cell(name)}</code></dt><dd>{escape(meaning)}</dd>" for name, meaning in entries)
    return f"<dl>{''.join(items)}</dl>"


def commands(lines: Iterable[str]) -> str:
    """Return lines to be typed."""
    text = "\n".join(lines)
    return f"<pre><code>{escape(text)}</code></pre>"
