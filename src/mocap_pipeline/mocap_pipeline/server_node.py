"""The server in one process: hull, ICP and EKF nodes on one executor, which pass their packets in memory.

The nodes keep their names, parameters, services and topics; packets are on the wire only for other subscribers. The
filter runs on the tracker's thread, so that a set changes threads three times: from the executor to the carver, the
slicer and the tracker.
"""

from __future__ import annotations

import sys

from ekf_tracker.ekf_node import EkfNode
from hull_server.hull_node import HullNode
from icp_tracker.icp_node import IcpNode
from sagoma_ros.process import run_nodes


def main(args: list[str] | None = None) -> None:
    """Entry point of the executable ``mocap_server``."""
    sys.exit(run_nodes([HullNode, IcpNode, EkfNode], args))


if __name__ == "__main__":
    main()
