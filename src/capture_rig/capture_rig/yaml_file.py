"""The one reader and writer of YAML: a mapping a file, within limits, no key twice; files appear whole or not at all.

What a file can do to the program is bounded before it is built: its size, how deep it nests, how many values it holds
once aliases are followed (an alias of an alias of ... grows exponentially), and how long its numbers are.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from .errors import InputError, shortened
from .files import read_text, write_text

MOST_YAML_BYTES = 4 << 20  # the largest that the programs write, the report of a rig of 32 cameras, has some 200 KB
MOST_DEPTH = 40  # the deepest that the programs write has 7
MOST_VALUES = 100_000  # read in some five seconds; the report of a large rig has a tenth of them
_LARGEST_WHOLE = 2**64 - 1  # stamps and seeds; what is longer is none of ours, and converting it may take for ever


def read_mapping(path: Path, remedy: str) -> Mapping[str, Any]:
    """Reads the mapping in a YAML file. Raises InputError as :func:`parse_mapping`, and when it cannot be read."""
    return parse_mapping(read_text(path, remedy, MOST_YAML_BYTES), shortened(str(path)), remedy)


def parse_mapping(text: str, where: str, remedy: str) -> Mapping[str, Any]:
    """Parses the mapping in a YAML text (empty for an empty text). Raises InputError with ``remedy`` if it is none."""
    document = parse_value(text, where, remedy)
    if document is None:
        return {}
    if not isinstance(document, Mapping):
        raise InputError("is not a mapping (key: value)", where=where, remedy=remedy)
    return document


def parse_value(text: str, where: str, remedy: str) -> Any:
    """Parses any YAML value. Raises InputError naming ``where`` and the line for what is none or passes a limit."""
    if len(text) > MOST_YAML_BYTES:
        raise InputError(f"is larger than {MOST_YAML_BYTES >> 20} MiB of YAML", where=where, remedy=remedy)
    try:
        loader = _Loader(text)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except yaml.YAMLError as error:
        raise InputError(f"is not valid YAML ({_problem(error)})", where=where, remedy=remedy) from None
    except Exception as error:  # whatever PyYAML's constructors raise, of a date that is none, a tag without a value
        what = f"is not valid YAML (a value does not fit its type: {shortened(str(error), 100)})"
        raise InputError(what, where=where, remedy=remedy) from None


def save_mapping(path: str | Path, document: Mapping[str, Any], heading: str = "", **style: Any) -> None:
    """Write a mapping in its own order, all or nothing, below an optional comment line. Raises InputError.

    style : of ``yaml.safe_dump``; lists of plain values stand on one line with ``default_flow_style=None``.
    """
    comment = f"# {heading}\n" if heading else ""
    write_text(path, comment + format_mapping(document, **style))


def format_mapping(document: Mapping[Any, Any], **style: Any) -> str:
    """A mapping as YAML text in its own order; what it holds twice is written twice."""
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, allow_unicode=True, **style)


def _problem(error: yaml.YAMLError) -> str:
    """Return the line and what is wrong there, in one line."""
    mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None)
    if mark is None or problem is None:
        return shortened(" ".join(str(error).split()))
    context, begun = getattr(error, "context", None), getattr(error, "context_mark", None)
    if context and begun is not None:
        context += f" begun in line {begun.line + 1}"
    return f"line {mark.line + 1}, column {mark.column + 1}: " + (f"{context}, " if context else "") + str(problem)


class _Dumper(yaml.SafeDumper):
    """YAML without anchors and aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


class _Loader(yaml.SafeLoader):
    """Safe YAML within limits; the same key twice is refused, where the standard loader silently keeps the last."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = self._values = 0
        self._size: dict[int, int] = {}  # of each finished node: values in it, aliases followed

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event, before = self.peek_event(), self._values
        self._depth += 1
        if self._depth > MOST_DEPTH:
            raise _error(f"nested more than {MOST_DEPTH} deep", event.start_mark)
        is_alias = isinstance(event, yaml.AliasEvent)
        node = super().compose_node(parent, index)
        self._depth -= 1
        if is_alias and id(node) not in self._size:
            raise _error(f"the alias '*{event.anchor}' holds itself", event.start_mark)
        self._values += self._size[id(node)] if is_alias else 1
        if self._values > MOST_VALUES:
            raise _error(f"more than {MOST_VALUES} values", event.start_mark)
        self._size[id(node)] = self._values - before
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen = set[Any]()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            try:
                if key in seen:
                    raise _error(f"key '{shortened(str(key), 60)}' appears twice", key_node.start_mark)
                seen.add(key)
            except TypeError:
                raise _error("a key is a list or a mapping", key_node.start_mark) from None
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        digits = len(str(node.value))
        value = super().construct_yaml_int(node) if digits <= 80 else _LARGEST_WHOLE + 1
        if abs(value) > _LARGEST_WHOLE:
            raise _error(f"a whole number of {digits} digits", node.start_mark)
        return value


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)


def _error(problem: str, mark: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
