"""The docstring line under each field of a class, read from its source: Python itself does not keep it."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Mapping
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
    try:
        tree = ast.parse(inspect.getsource(sys.modules[kind.__module__]))
    except (KeyError, OSError, TypeError):  # no such module, or one without a source file
        return {}
    classes = (node for node in tree.body if isinstance(node, ast.ClassDef))
    body = next((node.body for node in classes if node.name == kind.__name__), [])
    meanings = {}
    for statement, follower in pairwise(body):
        name, text = _assigned(statement), _text(follower)
        if name and text:
            meanings[name] = text
    return meanings


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
