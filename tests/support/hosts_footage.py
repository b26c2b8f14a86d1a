"""Run by namespaces.py's `inside`: footage of three cameras on three hosts, the last one started later.

hosts_footage.py FOLDER ; two lines of JSON: what `sagoma up --only cam01` says without a common beginning, with its
status; and of the server's frame sets, which cameras those before the first whole one lack, and the spread of the
stamps of the first whole ones.
"""

import datetime
import json
import subprocess
import sys
import threading
from pathlib import Path

from namespaces import World

from sagoma_ros.middleware import PROFILE_VARIABLE, profile_file
from stick_figure.body import Body
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

SERVER, FPS, CLIP_S = "server", 2.0, 15.0  # so few frames a second that a busy machine plays them
BEGIN_S = 5.0
WHOLE_SETS, PATIENCE_S = 10, 300.0
UP = [sys.executable, "-m", "sagoma_tools.cli", "up"]
LISTENER = Path(__file__).resolve().parents[2] / "tests/support/hosts_listener.py"


def main(folder):
    folder = Path(folder)
    session = write_session(folder / "session", ring(3, False), Body.from_stature(1.75), "walk", FPS, CLIP_S)
    environment = {"ROS_DOMAIN_ID": "3", "ROS_LOG_DIR": str(folder), PROFILE_VARIABLE: str(profile_file())}
    cameras = ["cam01", "cam02", "cam03"]
    with World([SERVER, *cameras]) as world:

        def up(host, part, *options, **pipes):
            words = ["--only", part, "--loop", "--run-folder", str(folder / host), *options]
            return world.hosts[host].start([*UP, str(session), *words], environment, **pipes)

        alone = up("cam01", "cam01", stderr=subprocess.PIPE, text=True)
        print(json.dumps({"says": alone.communicate()[1], "status": alone.returncode}), flush=True)
        told = world.hosts[SERVER].start([sys.executable, str(LISTENER), *cameras], environment, stdout=subprocess.PIPE)
        patience = threading.Timer(PATIENCE_S, told.kill)
        patience.start()
        begin = datetime.datetime.now(datetime.UTC) + datetime.timedelta(seconds=BEGIN_S)
        start_at = ("--start-at", begin.isoformat(timespec="seconds"))
        logs = {host: (folder / f"{host}.log").open("w") for host in world.hosts}
        up(SERVER, "server", *start_at, stdout=logs[SERVER], stderr=logs[SERVER])
        for camera in cameras[:2]:
            up(camera, camera, *start_at, stdout=logs[camera], stderr=logs[camera])
        early: list[list[str]] = []
        spread_ms: list[float] = []
        for line in told.stdout:
            each = json.loads(line)
            if "missing" not in each:
                continue
            if not each["missing"]:
                spread_ms.append(each["spread_ms"])
            elif not spread_ms:
                if (
                    each["missing"] == ["cam03"] and ["cam03"] not in early
                ):  # the first hosts play: now the last one starts
                    up("cam03", "cam03", *start_at, stdout=logs["cam03"], stderr=logs["cam03"])
                early.append(each["missing"])
            if len(spread_ms) == WHOLE_SETS:
                break
        patience.cancel()
        print(json.dumps({"early": early, "spread_ms": spread_ms}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
