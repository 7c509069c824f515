"""Configuration of Sphinx."""

from __future__ import annotations

from typing import Any

import numpydoc.numpydoc

import palletloc

project = "palletloc"
author = "the palletloc developers"
copyright = "the palletloc developers"  # noqa: A001 - the name is Sphinx's
version = release = palletloc.__version__

extensions = [
    "matplotlib.sphinxext.plot_directive",
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
]
templates_path = ["_templates"]
exclude_patterns = ["_build", "gallery/**/*.md5", "gallery/**/*.json"]

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("BoolArray", "FloatArray", "Image")}
python_maximum_signature_line_length = 100
autosummary_generate = True
numpydoc_show_class_members = False

plot_formats = [("svg", 100)]
plot_html_show_formats = False
plot_html_show_source_link = False

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "download_all_examples": False,
    "plot_gallery": "True",
    "remove_config_comments": True,
    "show_signature": False,
    "abort_on_example_error": True,
    "capture_repr": (),
}

html_theme = "furo"
html_title = f"palletloc {release}"
html_copy_source = False

_signature_of = numpydoc.numpydoc.mangle_signature


def _signature_unless_alias(app: Any, what: str, *rest: Any) -> tuple[str, str] | None:
    """Leave type aliases alone: numpydoc finds the array's signature in them, Sphinx has no place for it."""
    return None if what == "data" else _signature_of(app, what, *rest)


numpydoc.numpydoc.mangle_signature = _signature_unless_alias
