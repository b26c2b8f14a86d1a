"""Publishes a session's videos as other people's programs would: cameras of ROS drivers, and a detector of 2D joints.

    python bench/driver_stand_in.py SESSION --hz 30 --apart 1 --speed 0.5 --keypoints FOLDER

It uses rclpy, OpenCV and standard messages alone, nothing of this project: /driver/CAM/image_raw, and /CAM/keypoints of
FOLDER/CAM.csv. The first picture stays until a line comes on standard input; then the film plays once, and the stamp of
its frame 0, ns, is the line on standard output. ``--apart`` : by so many frames of the film every second camera exposes
later. ``--speed`` : of the stamps' time over this machine's.
"""

import argparse
import csv
import itertools
import math
import select
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import rclpy
from sensor_msgs.msg import Image, PointCloud2, PointField
from std_msgs.msg import Header

NUMBERS = ("x", "y", "cov_xx", "cov_xy", "cov_yy", "score")


def image(picture, header):
    """A grey picture as a driver sends it."""
    height, width = picture.shape
    return Image(header=header, height=height, width=width, encoding="mono8", step=width, data=picture.tobytes())


def cloud(row, header):
    """A row of a detector's table as the page docs/ros.md wants it: one skeleton, a field of six numbers a joint."""
    joints = [name.removesuffix("_x") for name in row if name.endswith("_x")]
    values = [float(row[f"{joint}_{number}"] or math.nan) for joint in joints for number in NUMBERS]
    fields = [PointField(name=joint, offset=24 * k, datatype=7, count=6) for k, joint in enumerate(joints)]
    size, data = 4 * len(values), np.array(values, np.float32).tobytes()
    made = PointCloud2(header=header, height=1, width=1, fields=fields, point_step=size, row_step=size, data=data)
    return made


class Camera:
    """One camera's film, its detections and publishers."""

    def __init__(self, node, video, late, table):
        self.name, self.late, self._frame, self._film = video.stem, late, -1, cv2.VideoCapture(str(video))
        self._images = node.create_publisher(Image, f"/driver/{self.name}/image_raw", 10)
        self._clouds = node.create_publisher(PointCloud2, f"/{self.name}/keypoints", 10)
        self._rows = {int(row.pop("frame")): row for row in csv.DictReader(table.open())} if table else {}
        self._show(0)

    def publish(self, frame, stamp_ns):
        """Publish the film's frame, and what the detector finds in it. False after the film's end."""
        if not self._show(frame):
            return False
        header = Header(frame_id=f"{self.name}_driver")
        header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        self._images.publish(image(self._picture, header))
        if frame in self._rows:
            self._clouds.publish(cloud(self._rows[frame], header))
        return True

    def _show(self, frame):
        while self._frame < frame:
            come, picture = self._film.read()
            if not come:
                return False
            self._frame, self._picture = self._frame + 1, np.ascontiguousarray(picture[:, :, 0])
        return True


def main():
    """Play."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("session", type=Path)
    parser.add_argument("--hz", type=float, default=30.0)
    parser.add_argument("--apart", type=int, default=0)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--keypoints", type=Path)
    given = parser.parse_args()
    rclpy.init(args=[])
    node = rclpy.create_node("driver")
    videos = sorted(given.session.glob("cam[0-9][0-9].mp4"))
    tables = [given.keypoints / f"{video.stem}.csv" if given.keypoints else None for video in videos]
    cameras = [Camera(node, v, given.apart * (k % 2), t) for k, (v, t) in enumerate(zip(videos, tables, strict=True))]
    film_hz = cv2.VideoCapture(str(videos[0])).get(cv2.CAP_PROP_FPS)
    step, first = round(film_hz / given.hz), None
    begin_s, begin_ns = time.monotonic(), time.time_ns()
    for tick in itertools.count():  # of the film's frames, at which some camera may expose
        time.sleep(max(0.0, begin_s + tick / film_hz / given.speed - time.monotonic()))
        if first is None and tick % step == 0 and select.select([sys.stdin], [], [], 0.0)[0]:
            first = tick
            print(begin_ns + round(tick * 1e9 / film_hz), flush=True)
        frame, stamp_ns = 0 if first is None else tick - first, begin_ns + round(tick * 1e9 / film_hz)
        exposing = [camera for camera in cameras if (tick - camera.late) % step == 0]
        if not all(camera.publish(frame, stamp_ns) for camera in exposing):
            break
    rclpy.shutdown()


if __name__ == "__main__":
    main()
