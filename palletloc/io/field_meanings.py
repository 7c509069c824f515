"""The docstring line under each field of a class, read from its source: Python itself does not keep it."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Mapping
from functools import cache
from itertools import pairwise


def field_meanings(kind: type) -> Mapping[str, str]:
    """Return what a class says about its fields or members.

    Parameters
    ----------
    kind : type
        A dataclass or an enumeration at the top level of its module.

    Returns
    -------
    mapping of str to str
        Docstring by name, on one line; empty where the source is not at hand.

    Examples
    --------
    >>> from palletloc.measurement import HeightPrior
    >>> field_meanings(HeightPrior)["sigma"]
    'Standard deviation, in metres.'
    """
    return _classes(kind.__module__).get(kind.__name__, {})


@cache
def _classes(module: str) -> Mapping[str, Mapping[str, str]]:
    """Return what the classes of a module say about their fields, by the class's name."""
    try:
        tree = ast.parse(inspect.getsource(sys.modules[module]))
    except (KeyError, OSError, TypeError):  # no such module, or one without a source file
        return {}
    return {node.name: _meanings(node) for node in tree.body if isinstance(node, ast.ClassDef)}


def _meanings(node: ast.ClassDef) -> Mapping[str, str]:
    pairs = ((_assigned(statement), _text(follower)) for statement, follower in pairwise(node.body))
    return {name: text for name, text in pairs if name and text}


def _assigned(statement: ast.stmt) -> str:
    """Return the name that a statement gives a value or a type; empty where it does neither."""
    match statement:
        case ast.AnnAssign(target=ast.Name(id=name)) | ast.Assign(targets=[ast.Name(id=name)]):
            return name
    return ""


def _text(statement: ast.stmt) -> str:
    match statement:
        case ast.Expr(value=ast.Constant(value=str(text))):
            return " ".join(text.split())
    return ""
