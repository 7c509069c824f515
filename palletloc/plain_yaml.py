"""Reading of YAML as people write it: plain values in bounded time and memory, and no number that means another.

YAML 1.1 has more numbers than people know: ``010`` is 8, ``268:26:35`` is 966395, ``0x1F`` is 31. Only decimal
numbers are numbers here, all others stay texts; whoever reads a number can ask `number_hint` what such a text might
mean. References (``&a``, ``*a``) are read as far as what they stand for is not much larger than the file.
"""

from __future__ import annotations

import re
from typing import Any

import yaml

from palletloc.errors import PalletLocError

_MOST_CHARACTERS = 1 << 20
"""Of a text that is read without libyaml: some seconds."""
_MOST_VALUES = 500_000
"""That a document may have, those that references stand for included: some hundred megabytes in memory."""
_MOST_REFERRED = 50_000
"""Values that references may stand for: far more than people write."""
_DEEPEST = 100
"""Nesting of a document: far beyond any real one; libyaml overruns the stack on some tens of thousands."""
_PLAIN = "tag:yaml.org,2002:"
"""How the tags of YAML's own kinds begin."""
_TAGS = {_PLAIN + kind for kind in ("str", "int", "float", "bool", "null", "seq", "map")}
"""Tags that are understood: what they make is a plain value."""
_INT = re.compile(r"[-+]?(?:0|[1-9][0-9_]{0,30})$")
"""A whole number. A longer one is a text, so that it is not turned into an integer without end."""
_FLOAT = re.compile(
    r"[-+]?(?:[0-9][0-9_]*\.[0-9_]*(?:[eE][-+][0-9]+)?|\.[0-9][0-9_]*(?:[eE][-+][0-9]+)?|\.(?:inf|Inf|INF))$"
    r"|\.(?:nan|NaN|NAN)$"
)
"""A number with a decimal point, as YAML 1.1 has them but for those on base 60."""
_BASE_60 = re.compile(r"([-+]?)(\d+):([0-5]?\d)(?::([0-5]?\d(?:\.\d*)?))?$")
"""Degrees or hours, minutes and seconds."""
_OTHER_BASE = re.compile(r"[-+]?0(?:[xX][0-9a-fA-F_]+|[oObB]?[0-9_]+)$")
"""A hexadecimal, binary or octal number, or a decimal one with leading zeros."""


class YamlError(PalletLocError):
    """A text that is not the YAML that is read here; whoever knows the file adds its name.

    Parameters
    ----------
    problem : str
        What is wrong, and what was expected.
    line : int, optional
        Line in the text, from 1.
    """

    def __init__(self, problem: str, line: int | None = None) -> None:
        super().__init__(problem)
        self.line = line

    def of(self, file: object) -> str:
        """Return the message about a file."""
        return f"{file}: {self}" if self.line is None else f"{file}, line {self.line}: {self}"


class _PlainLoader(yaml.SafeLoader):
    """The safe loader with decimal numbers only."""


_PlainLoader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in known if tag.removeprefix(_PLAIN) not in ("int", "float")]
    for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _tag, _pattern, _first in (("float", _FLOAT, "-+0123456789."), ("int", _INT, "-+0123456789")):
    _PlainLoader.add_implicit_resolver(_PLAIN + _tag, _pattern, list(_first))
_LOADERS: list[type[Any]] = [_PlainLoader]
"""By libyaml first, where that is there; what that takes for a mistake, such as ``{key:}``, the other may know."""
if yaml.__with_libyaml__:

    class _FastLoader(yaml.CSafeLoader):
        """The same by libyaml, which is ten times as fast."""

    _FastLoader.yaml_implicit_resolvers = _PlainLoader.yaml_implicit_resolvers
    _LOADERS.insert(0, _FastLoader)


def load_plain(text: str, *, tags: bool = True, deepest: int = _DEEPEST) -> Any:
    """Return what a YAML text holds: mappings, lists, texts, numbers, true and false, nothing.

    Parameters
    ----------
    text : str
        One document.
    tags : bool
        Whether the tags of these kinds (``!!str``) are read; other tags never are.
    deepest : int
        Deepest nesting that is read.

    Raises
    ------
    YamlError
        If it is not YAML, a key stands there twice, or it is nested, refers or has more than is read; names the line.
    """
    for loader in _LOADERS:
        try:
            return _loaded(text, loader, _Count(_TAGS if tags else set(), deepest))
        except yaml.MarkedYAMLError as error:
            line = None if error.problem_mark is None else error.problem_mark.line + 1
            fault = YamlError(f"is not yaml: {error.problem or error.context}", line)
        except (yaml.YAMLError, ValueError, RecursionError) as error:
            fault = YamlError(f"is not yaml: {' '.join(str(error).split())}")
        if len(text) > _MOST_CHARACTERS:
            break
    raise fault


def _loaded(text: str, loader: type[Any], count: _Count) -> Any:
    for event in yaml.parse(text, Loader=loader):
        count.take(event)
    reader = loader(text)
    root = reader.get_single_node()
    if root is None:
        return None
    _refuse_repeated_keys(root)
    return reader.construct_document(root)


def number_hint(given: object) -> str:
    """Return what a text in a number's place might mean, as the end of a message; nothing where that is not known.

    Examples
    --------
    >>> number_hint("268:26:35")
    '; is it degrees:minutes:seconds? In decimals that is 268.443056'
    >>> number_hint("010")
    '; expected it in decimals, without zeros before it'
    >>> number_hint("west")
    ''
    """
    if not isinstance(given, str) or len(given) > 100:
        return ""
    if match := _BASE_60.match(given):
        sign, whole, minutes, seconds = match.groups()
        value = int(whole) + int(minutes) / 60 + float(seconds or 0) / 3600
        return f"; is it degrees:minutes:seconds? In decimals that is {sign}{value:.9g}"
    if is_other_base(given):
        return "; expected it in decimals, without zeros before it"
    return ""


def is_other_base(text: str) -> bool:
    """Tell whether a text is a number to YAML 1.1 or to C, but not the decimal one that it looks like."""
    return _OTHER_BASE.match(text) is not None and text.strip("+-0") != ""


class _Count:
    """Counts the values of a document, those that references stand for included."""

    def __init__(self, tags: set[str], deepest: int) -> None:
        self._tags = tags
        self._deepest = deepest
        self._sizes: dict[str | None, int] = {}
        """Values behind each anchor."""
        self._open: list[tuple[str | None, int]] = []
        """Anchors of the mappings and lists that are open, and how many values there were before each."""
        self._values = self._referred = 0

    def take(self, event: Any) -> None:
        """Count an event of the parser; raise where there is more than is read."""
        line = event.start_mark.line + 1 if event.start_mark else None
        before = self._values + self._referred
        if isinstance(event, yaml.CollectionEndEvent):
            anchor, since = self._open.pop()
            self._sizes[anchor] = before - since
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor in {anchor for anchor, _ in self._open}:
                raise YamlError(f"is not yaml: '*{event.anchor}' stands for itself", line)
            self._referred += self._sizes.get(event.anchor, 1)
        elif isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent):
            if event.tag is not None and event.tag not in self._tags:
                tag = repr(event.tag[:60])
                raise YamlError(f"is not yaml: the tag {tag} is not understood; expected plain values", line)
            self._values += 1
            self._sizes[event.anchor] = 1
            if isinstance(event, yaml.CollectionStartEvent):
                self._open.append((event.anchor, before))
        self._refuse_excess(line)

    def _refuse_excess(self, line: int | None) -> None:
        if len(self._open) > self._deepest:
            raise YamlError(f"is not yaml: nested too deeply; expected at most {self._deepest} levels")
        if self._referred > _MOST_REFERRED:
            raise YamlError(f"is not yaml: its references stand for more than {_MOST_REFERRED} values", line)
        if self._values > _MOST_VALUES:
            raise YamlError(f"is not yaml: has more than {_MOST_VALUES} values", line)


def _refuse_repeated_keys(root: yaml.Node) -> None:
    pending, visited = [root], set[int]()
    while pending:
        node = pending.pop()
        if id(node) in visited or isinstance(node, yaml.ScalarNode):
            continue
        visited.add(id(node))  # a reference leads to the same node again
        if not isinstance(node, yaml.MappingNode):
            pending += node.value
            continue
        keys = set[str]()
        for key, value in node.value:
            name = str(key.value) if isinstance(key, yaml.ScalarNode) else ""
            if name in keys and key.tag != _PLAIN + "merge":
                raise YamlError(f"is not yaml: key '{name[:60]}' stands there twice", key.start_mark.line + 1)
            keys.add(name)
            pending.append(value)
