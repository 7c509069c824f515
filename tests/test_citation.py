"""CITATION.cff, by the rules of the Citation File Format 1.2.0."""

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[1]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PERSON = {"family-names", "given-names", "affiliation", "orcid", "email", "website", "alias"}


def test_it_has_what_the_format_demands_and_agrees_with_the_project() -> None:
    assert {"cff-version", "message", "title", "authors"} <= set(CITATION)
    assert CITATION["cff-version"] == "1.2.0"
    assert CITATION["type"] in ("software", "dataset")
    assert (CITATION["title"], CITATION["version"]) == (PROJECT["name"], PROJECT["version"])
    assert CITATION["license"] == PROJECT["license"]
    assert all(author.get("name") or PERSON & set(author) for author in CITATION["authors"])
    assert len(CITATION["keywords"]) == len(set(CITATION["keywords"]))


def test_the_paper_is_the_reference_with_its_authors_in_order() -> None:
    (paper,) = CITATION["references"]
    assert {"type", "title", "authors"} <= set(paper)
    assert [author["family-names"] for author in paper["authors"]] == ["Kita", "Fujieda", "Matsuda", "Kita"]
    assert all(set(author) <= PERSON for author in paper["authors"])
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert re.sub(r"\s+", " ", paper["title"]) in readme.replace("*", "")
