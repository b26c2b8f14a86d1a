"""The one reader and writer of YAML: a mapping a file, limited, no key twice; files appear whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from .errors import InputError, shortened
from .files import read_text, write_text

MOST_YAML_BYTES = 4 << 20  # the largest that the programs write, the report of a rig of 32 cameras, has some 200 KB
MOST_VALUES = 100_000  # read in some five seconds; the report of a large rig has a tenth of them
_LARGEST_WHOLE = 2**64 - 1  # stamps and seeds


def read_mapping(path: Path, remedy: str) -> Mapping[str, Any]:
    """Reads the mapping in a YAML file. Raises InputError as :func:`parse_mapping`, and when it cannot be read."""
    return parse_mapping(read_text(path, remedy, MOST_YAML_BYTES), shortened(str(path)), remedy)


def parse_mapping(text: str, where: str, remedy: str) -> Mapping[str, Any]:
    """Parse the mapping in a YAML text (empty for an empty text). Raises InputError with ``remedy`` for other text."""
    document = parse_value(text, where, remedy)
    if document is None:
        return {}
    if not isinstance(document, Mapping):
        raise InputError("is not a mapping (key: value)", where=where, remedy=remedy)
    return document


def parse_value(text: str, where: str, remedy: str) -> Any:
    """Parse any YAML value. Raises InputError naming ``where`` and the line for invalid or oversized text."""
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
    except Exception as error:  # PyYAML raises many kinds: for an invalid date, a tag without a value, deep nesting
        what = f"is not valid YAML (a value cannot be read: {shortened(str(error), 100)})"
        raise InputError(what, where=where, remedy=remedy) from None


def save_mapping(path: str | Path, document: Mapping[str, Any], heading: str = "", **style: Any) -> None:
    """Write a mapping in its own order, all or nothing, below an optional comment line. Raises InputError.

    style : of ``yaml.safe_dump``; lists of plain values stand on one line with ``default_flow_style=None``.
    """
    comment = f"# {heading}\n" if heading else ""
    write_text(path, comment + format_mapping(document, **style))


def format_mapping(document: Mapping[Any, Any], **style: Any) -> str:
    """Return a mapping as YAML text in its own order, without aliases."""
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, allow_unicode=True, **style)


def _problem(error: yaml.YAMLError) -> str:
    """Return line number and fault in one line."""
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
    """Safe YAML with a limit of values, aliases expanded (an alias of an alias of ... grows exponentially); duplicate
    keys are refused, where the standard loader silently keeps the last."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._values = 0
        self._size: dict[int, int] = {}  # of each finished node: values in it

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        is_alias, before = self.check_event(yaml.AliasEvent), self._values
        node = super().compose_node(parent, index)
        # an alias inside its own anchor has no size yet
        self._values += self._size.get(id(node), MOST_VALUES) if is_alias else 1
        if self._values > MOST_VALUES:
            raise _error(f"more than {MOST_VALUES} values", node)
        self._size[id(node)] = self._values - before
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen = set[Any]()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            try:
                if key in seen:
                    raise _error(f"key '{shortened(str(key), 60)}' appears twice", key_node)
                seen.add(key)
            except TypeError:
                raise _error("a key is a list or a mapping", key_node) from None
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        value = super().construct_yaml_int(node)
        if abs(value) > _LARGEST_WHOLE:
            raise _error(f"a whole number of {len(str(node.value))} digits", node)
        return value


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)


def _error(problem: str, place: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=place.start_mark)
