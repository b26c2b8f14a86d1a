"""Reading YAML that a person wrote: one mapping per file, and no key twice."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from .errors import InputError


def read_mapping(path: Path, remedy: str) -> Mapping[str, Any]:
    """The mapping in a YAML file (empty for an empty file); InputError with ``remedy`` when it holds none."""
    try:
        document = yaml.load(path.read_text(encoding="utf-8"), Loader=_UniqueKeyLoader)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=str(path), remedy=remedy) from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        problem = " ".join(str(error).split())
        raise InputError(f"is not valid YAML ({problem})", where=str(path), remedy=remedy) from None
    if document is None:
        return {}
    if not isinstance(document, Mapping):
        raise InputError("is not a mapping (key: value)", where=str(path), remedy=remedy)
    return document


class _UniqueKeyLoader(yaml.SafeLoader):
    """YAML that refuses the same key twice, where the standard loader silently keeps the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        for key in keys:
            if keys.count(key) > 1:
                raise yaml.MarkedYAMLError(problem=f"key '{key}' appears twice", problem_mark=node.start_mark)
        return super().construct_mapping(node, deep)
