"""``sagoma security KEYSTORE``: certificates and permissions (SROS 2) for the processes of the graph that runs."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from capture_rig.errors import InputError
from sagoma_bringup.graph import CAMERA_NODE
from sagoma_bringup.processes import SERVER_EXECUTABLE

from ..arguments import NODES, SECONDS
from ..graph.ros_link import RosLink
from .graph import discover

TOOLS = "tools"


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the subcommand."""
    help_text = "make certificates and permissions (SROS 2) for the graph that runs (docs/security.md)"
    parser = subparsers.add_parser("security", help=help_text)
    parser.add_argument("keystore", help="folder to make, or to renew: its authority stays")
    parser.add_argument("--expect", type=NODES, default=1, help="wait until so many sagoma nodes are found")
    parser.add_argument("--wait", type=SECONDS, default=5.0, help="... but no longer than this, in seconds")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Look at the graph, write the keystore, and say how it is used."""
    try:
        from ..security.access import ANYTHING, Access, access_of_node
        from ..security.keystore import ENCLAVES, write_keystore
    except ImportError as error:
        raise InputError(str(error), where="sagoma security", remedy="pip install cryptography") from None
    keystore = Path(args.keystore)
    accesses: dict[str, Access] = {TOOLS: ANYTHING}
    with RosLink("sagoma_security") as link:
        for name in discover(link.node, args.expect, args.wait):
            enclave = enclave_of(name)
            accesses[enclave] = accesses.get(enclave, Access()) | access_of_node(link.node, name)
    folders = write_keystore(keystore, accesses, int(os.environ.get("ROS_DOMAIN_ID", "0")))
    for folder in folders:
        print(folder)
    print(f"on every machine: its enclaves under {keystore}/enclaves (never {keystore}/private), and")
    print(f"  export ROS_SECURITY_KEYSTORE={keystore.resolve()} ROS_SECURITY_ENABLE=true ROS_SECURITY_STRATEGY=Enforce")
    print(f"tools: export ROS_SECURITY_ENCLAVE_OVERRIDE={ENCLAVES}/{TOOLS}   (sagoma up gives its processes their own)")
    return 0


def enclave_of(name: str) -> str:
    """Return the enclave's name of the node with this full name: its camera's, or the server's."""
    namespace, _, base = name.strip("/").rpartition("/")
    return namespace.replace("/", "_") if base == CAMERA_NODE and namespace else SERVER_EXECUTABLE
