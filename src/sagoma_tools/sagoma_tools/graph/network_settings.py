"""Settings of the middleware for a graph on several machines: its profile, and the addresses of the others.

They are environment variables, which a process reads when it first touches ROS, and which its children inherit.
"""

from __future__ import annotations

import argparse
import ipaddress
import os
from collections.abc import MutableMapping
from pathlib import Path

from capture_rig.errors import InputError
from sagoma_ros.memory import QOS_FROM_PROFILE

PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
PEERS_VARIABLE, RANGE_VARIABLE = "ROS_STATIC_PEERS", "ROS_AUTOMATIC_DISCOVERY_RANGE"
ALONE = "LOCALHOST"  # with peers: they are asked by unicast, and nobody else


def add_peers_argument(parser: argparse.ArgumentParser) -> None:
    """--peers ADDRESS,...; :func:`use_peers` takes its text."""
    text = "the other machines of the graph: found by unicast alone, with our Fast DDS profile (docs/hosts.md)"
    parser.add_argument("--peers", metavar="ADDRESS,...", help=text)


def use_peers(text: str, environment: MutableMapping[str, str] = os.environ) -> None:
    """Let this process and its children find these machines by unicast, ``ADDRESS,ADDRESS,...``, and no others.

    The profile of :func:`profile_file` is used, unless the environment names another one. Every machine names at least
    the server; the server, all of them. Raises InputError for what is no address.
    """
    addresses = [_address(word.strip()) for word in text.split(",")]
    environment[PEERS_VARIABLE] = ";".join(addresses)
    environment[RANGE_VARIABLE] = ALONE
    if not environment.get(PROFILE_VARIABLE):
        environment[PROFILE_VARIABLE] = str(profile_file())
        environment[QOS_FROM_PROFILE] = "1"  # its memory policies are taken with this alone


def profile_file() -> Path:
    """Return our Fast DDS profile, in the share folder of an installed sagoma_bringup, or in the tree."""
    from sagoma_ros.names import package_path  # loads ROS

    return package_path("package://sagoma_bringup/config/dds/fastdds.xml").resolve()


def _address(word: str) -> str:
    try:
        return str(ipaddress.IPv4Address(word))
    except ValueError:
        remedy = "Write --peers ADDRESS,ADDRESS with the machines' IPv4 addresses, as 192.168.1.7."
        raise InputError(f"'{word}' is no IPv4 address", where="--peers", remedy=remedy) from None
