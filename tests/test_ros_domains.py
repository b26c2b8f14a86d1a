"""Files of tests find their ROS domain quiet, whatever earlier ones left behind."""

import gc
import os
import socket
import subprocess
import sys

import pytest
import rclpy
from rclpy.context import Context
from ros_domains import DOMAINS, OwnDomains, domains_in_use


def participant(domain):
    """A node and its context, which refer to each other: only the garbage collection frees them."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("leftover", context=context)
    node.itself = node
    rclpy.shutdown(context=context)
    return node


def test_domain_is_used_again_with_garbage_or_a_listener_in_it_and_left_where_a_node_stays():
    own = OwnDomains()
    domain = own.quiet()
    gc.disable()
    try:
        participant(domain)
        assert domain in domains_in_use()
        assert own.quiet() == domain and domain not in domains_in_use()
    finally:
        gc.enable()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:  # `sagoma doctor` listens, and is in no domain
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", 7400 + 250 * domain))
        assert own.quiet() == domain
    node = participant(domain)
    assert own.quiet() not in {domain, int(os.environ["ROS_DOMAIN_ID"])} and node.get_name() == "leftover"


def test_domain_of_another_process_is_not_taken():
    own = OwnDomains()
    mine = own.quiet()
    taken = subprocess.run(
        [sys.executable, "-c", "from ros_domains import OwnDomains; print(OwnDomains().quiet())"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.path.dirname(sys.modules["ros_domains"].__file__)},
        check=True,
    )
    assert int(taken.stdout) in set(DOMAINS) - {mine}
    with pytest.raises(RuntimeError, match=f"all ROS domains from {mine} to {mine} are in use"):
        OwnDomains([mine]).quiet()
