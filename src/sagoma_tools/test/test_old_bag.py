"""A bag of an older version still serves: data/bag_with_rims, three frame sets of two cameras with topic /hull/rims."""

import json
import logging
import shutil
import threading
from pathlib import Path

from sensor_msgs.msg import PointCloud2

from sagoma_tools.cli import main
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.topics import LOSSLESS
from sagoma_tools.recording.reader import bag_topics, frame_tolerance_ns, read_frame_sets, read_messages

BAG = Path(__file__).parent / "data" / "bag_with_rims"
RAYS = "/hull/contour_rays"


def test_renamed_topic_is_read_under_its_present_name_with_one_warning(tmp_path, caplog):
    bag = shutil.copytree(BAG, tmp_path / "bag")
    with caplog.at_level(logging.WARNING, "sagoma.bags"):
        assert bag_topics(bag)[RAYS] == "sensor_msgs/msg/PointCloud2" and "/hull/rims" not in bag_topics(bag)
        assert [message.topic for message in read_messages(bag, RAYS.__eq__)] == [RAYS] * 3
    (warning,) = [record.getMessage() for record in caplog.records]
    assert "/hull/rims" in warning and RAYS in warning


def test_frame_sets_of_an_old_bag_are_whole():
    sets = list(read_frame_sets(BAG, frame_tolerance_ns(BAG)))
    assert [sorted(one.frames) for one in sets] == [["cam01", "cam02"]] * 3
    assert all(len(messages) == 2 for one in sets for messages in one.frames.values())


def test_old_bag_is_evaluated_and_compared(capsys):
    assert main(["evaluate", str(BAG), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert (figures["frames"], figures["tracked"], figures["states"]) == (3, 3, {"tracking": 3})
    assert main(["compare", str(BAG), str(BAG)]) == 0
    assert "identical" in capsys.readouterr().out


def test_old_bag_is_replayed_under_the_present_name():
    heard, enough = [], threading.Event()

    def take(message):
        heard.append(message.width)
        if len(heard) == 3:
            enough.set()

    with RosLink("listener") as listener:
        listener.node.create_subscription(PointCloud2, RAYS, take, LOSSLESS)
        for _ in range(5):  # discovery may take longer than the bag lasts
            assert main(["replay", str(BAG), "--topics", "outputs", "--rate", "0.1"]) == 0
            if enough.wait(0.5):
                break
    assert set(heard) == {4} and enough.is_set()
