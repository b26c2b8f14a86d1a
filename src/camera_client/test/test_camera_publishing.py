"""A live camera's frames are published on a thread of their own: bounded, counted, in order, all sent at the end."""

import threading

from node_probe import SUCCESS

from camera_client.frame_stages_ros import PUBLISH_DEPTH


class Gate:
    """Stands for a middleware that blocks: takes a frame only when it is open."""

    def __init__(self):
        self.open, self.stamps_ns, self.threads = threading.Event(), [], set()

    def publish_uncalibrated(self, frame):
        self.threads.add(threading.current_thread())
        self.open.wait()
        self.stamps_ns.append(frame.stamp_ns)


def test_middleware_that_blocks_costs_stale_frames_and_never_holds_the_grab(gige_camera, bench):
    simulated = gige_camera()
    camera = bench(**{"camera_name": "cam01", "source": "aravis", "aravis.address": simulated.address})
    assert camera.node.trigger_configure() == SUCCESS
    gate = Gate()
    camera.node._topics.publish_uncalibrated = gate.publish_uncalibrated
    assert camera.node.trigger_activate() == SUCCESS
    loop, unpublished = camera.node.loop, lambda: camera.node.health.counter("frames_unpublished")
    camera.until(lambda: unpublished() > 2 * PUBLISH_DEPTH)  # frames go on coming
    gate.open.set()
    camera.until(lambda: len(gate.stamps_ns) > 2 * PUBLISH_DEPTH)
    assert camera.node.trigger_deactivate() == SUCCESS
    assert len(gate.stamps_ns) + unpublished() == loop.frames  # none is left, none lost uncounted
    assert gate.stamps_ns == sorted(set(gate.stamps_ns))
    assert {thread.name for thread in gate.threads} == {"publish"}
    assert int(camera.node.health.counter("failed_frames")) == 0
