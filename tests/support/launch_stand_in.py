"""A stand-in for ROS 2's launch and launch_ros, which are not on PyPI: enough of them to run our launch files.

It follows launch_ros of Jazzy in what decides how our nodes run: arguments with defaults and choices, namespaces
(relative ones stand below the pushed one, none means the pushed one itself), the order of parameter files, respawn,
and a shutdown when a process ends. A launch file that uses anything else fails here.
"""

from __future__ import annotations

import os
import re
import sys
import types
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

SOURCES = Path(__file__).resolve().parents[2] / "src"


class Context:
    """Values of the arguments."""

    def __init__(self, **values: object) -> None:
        self.values = {name: str(value) for name, value in values.items()}


class DeclareLaunchArgument:
    def __init__(
        self, name: str, *, default_value: str | None, description: str | None, choices: list | None = None
    ) -> None:
        self.name, self.default, self.description, self.choices = name, default_value, description, choices

    def visit(self, context: Context) -> None:
        if self.name not in context.values:
            if self.default is None:
                raise RuntimeError(f"Required launch argument '{self.name}' was not provided.")
            context.values[self.name] = self.default
        if self.choices and context.values[self.name] not in self.choices:
            raise RuntimeError(f"Argument '{self.name}' provided value is not valid.")


@dataclass
class OpaqueFunction:
    function: Any


@dataclass
class LaunchConfiguration:
    name: str

    def perform(self, context: Context) -> str:
        return context.values[self.name]


@dataclass
class Node:
    """launch_ros.actions.Node, and what it starts once ``full_namespace`` is known."""

    package: str
    executable: str
    name: str | None = None
    namespace: str | None = None
    parameters: list[Any] = field(default_factory=list)
    output: str = "log"
    respawn: bool = False
    respawn_delay: float | None = None
    full_namespace: str | None = None


def below(base: str | None, namespace: str | None) -> str | None:
    """The namespace of a node that asks for ``namespace`` where ``base`` was pushed (launch_ros, prefix_namespace)."""
    if namespace is None:
        found = base
    elif not base or namespace.startswith("/"):
        found = namespace
    else:
        found = f"{base.rstrip('/')}/{namespace}"
    return None if found is None else "/" + found.strip("/")


@contextmanager
def stood_in() -> Iterator[None]:
    """Modules launch and launch_ros with just the names above; and our module that imports them, loaded anew."""
    contents = {
        "launch": {},
        "launch.launch_description": {"LaunchDescription": list},
        "launch.actions": {kind.__name__: kind for kind in (DeclareLaunchArgument, OpaqueFunction)},
        "launch.logging": {"launch_config": types.SimpleNamespace(log_dir=os.environ.get("ROS_LOG_DIR"))},
        "launch.substitutions": {"LaunchConfiguration": LaunchConfiguration},
        "launch_ros": {},
        "launch_ros.actions": {"Node": Node},
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, attributes in contents.items():
            module = types.ModuleType(name)
            module.__dict__.update(attributes)
            patch.setitem(sys.modules, name, module)
        patch.delitem(sys.modules, "sagoma_bringup.launch_nodes", raising=False)
        try:
            yield
        finally:
            sys.modules.pop("sagoma_bringup.launch_nodes", None)


# --- what a launch file starts


def launched(path: Path, pushed: str | None = None, **arguments: object) -> list[Node]:
    """The nodes that a launch file, Python or XML, starts; where ``pushed``, included below a pushed namespace."""
    context, nodes = Context(**arguments), []
    with stood_in():
        for entity in _entities(path, context):
            if isinstance(entity, DeclareLaunchArgument):
                entity.visit(context)
            else:
                nodes += entity.function(context)
    for node in nodes:
        node.full_namespace = below(below(None, pushed), node.namespace)
    return nodes


def _entities(path: Path, context: Context) -> list[Any]:
    if path.suffix == ".xml":
        return _from_xml(ET.parse(path).getroot(), context)
    module = types.ModuleType(path.stem)
    exec(compile(path.read_text(), str(path), "exec"), module.__dict__)
    return module.generate_launch_description()


def _from_xml(root: ET.Element, context: Context) -> list[Any]:
    made: list[Any] = []
    for element in root:
        if element.tag == "arg":
            default, text = element.get("default"), element.get("description")
            made.append(DeclareLaunchArgument(str(element.get("name")), default_value=default, description=text))
        else:
            assert element.tag == "include", f"the stand-in knows no <{element.tag}>"
            given = {str(arg.get("name")): _text(arg.get("value"), context) for arg in element.findall("arg")}
            context.values.update(given)
            included = _entities(Path(_text(element.get("file"), context)), context)
            required = {e.name for e in included if isinstance(e, DeclareLaunchArgument) and e.default is None}
            assert required <= set(given), "launch wants required arguments to be handed over"
            made += included
    return made


def _text(text: str | None, context: Context) -> str:
    text = re.sub(r"\$\(var (\w+)\)", lambda found: context.values[found[1]], text or "")
    return re.sub(r"\$\(find-pkg-share (\w+)\)", lambda found: str(SOURCES / found[1]), text)


def module_of(package: str, executable: str) -> str:
    """The module that the package's setup.py names for an executable."""
    found = re.search(rf'"{executable} = ([\w.]+):main"', (SOURCES / package / "setup.py").read_text())
    assert found is not None, f"{package} has no executable {executable}"
    return found[1]
