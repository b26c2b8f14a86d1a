"""Names that nodes resolve: topics of the graph that a camera belongs to, files in the share folder of a package."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rclpy.node import Node

from capture_rig.errors import InputError

SCHEME = "package://"


def graph_topic(node: Node, topic: str) -> str:
    """Return ``topic`` as the whole graph has it; a camera's node stands in a namespace of its own below the graph's.

    "hull/thinning" for /studio/cam01/camera_client is "/studio/hull/thinning"; an absolute topic stays as it is.
    """
    if topic.startswith("/"):
        return topic
    return f"{node.get_namespace().rpartition('/')[0]}/{topic}"


def resolve_packages(value: Any) -> Any:
    """Return texts that begin with ``package://`` as paths (also those of a list), everything else as it is."""
    if isinstance(value, list):
        return [resolve_packages(one) for one in value]
    return str(package_path(value)) if isinstance(value, str) and value.startswith(SCHEME) else value


def package_path(uri: str) -> Path:
    """Return the path of ``package://PACKAGE/FILE``: in the share folder of an installed package, else in its sources.

    Raises InputError for a package that is not there.
    """
    package, _, file = uri.removeprefix(SCHEME).partition("/")
    try:
        return Path(get_package_share_directory(package)) / file
    except (PackageNotFoundError, OSError, ValueError):  # not there, nothing sourced at all, no name of a package
        found = importlib.util.find_spec(package) if package.isidentifier() else None
    if found is None or found.origin is None:
        remedy = "Source the workspace that has it, or give the file's path."
        raise InputError(f"there is no package '{package}'", where=uri, remedy=remedy)
    return Path(found.origin).parents[1] / file
