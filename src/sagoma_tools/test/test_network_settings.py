"""The middleware's settings for several machines: what --peers sets, and that Fast DDS takes the profile."""

import os
import subprocess
import sys

import pytest

from capture_rig.errors import InputError
from sagoma_ros.middleware import PROFILE_VARIABLE, QOS_FROM_PROFILE, profile_file, use_peers

LOAD = "from sagoma_tools.graph.ros_link import RosLink\nwith RosLink('loader'): print('loaded')"


def test_peers_are_asked_by_unicast_with_our_profile():
    environment = {}
    use_peers("192.168.1.7, 192.168.1.8", environment)
    assert environment == {
        "ROS_STATIC_PEERS": "192.168.1.7;192.168.1.8",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        PROFILE_VARIABLE: str(profile_file()),
        QOS_FROM_PROFILE: "1",
    }


def test_a_profile_that_was_chosen_stays():
    environment = {PROFILE_VARIABLE: "mine.xml"}
    use_peers("192.168.1.7", environment)
    assert environment[PROFILE_VARIABLE] == "mine.xml"


@pytest.mark.parametrize("text", ["", "server.local", "192.168.1.7;192.168.1.8", "192.168.1.300", "192.168.1.7,"])
def test_what_is_no_address_is_refused(text):
    environment = {}
    with pytest.raises(InputError, match="is no IPv4 address") as refused:
        use_peers(text, environment)
    assert "--peers" in str(refused.value) and environment == {}


@pytest.mark.parametrize("spoilt", [False, True])
def test_the_middleware_reads_the_profile_without_a_word_and_complains_of_a_spoilt_one(tmp_path, spoilt):
    profile = tmp_path / "profile.xml"
    text = profile_file().read_text()
    profile.write_text(text.replace("leaseDuration>", "leaseDurations>") if spoilt else text)
    environment = {**os.environ, PROFILE_VARIABLE: str(profile)}
    done = subprocess.run([sys.executable, "-c", LOAD], capture_output=True, text=True, env=environment, check=True)
    assert "loaded" in done.stdout
    assert ("XMLPARSER" in done.stdout + done.stderr) == spoilt
