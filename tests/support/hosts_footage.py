"""Run by namespaces.py's `inside`: footage of three cameras on three hosts, the last one started seconds later.

hosts_footage.py FOLDER ; two lines of JSON: what `sagoma up --only cam01` says without a common beginning, with its
status; and the frame sets of the server once the late host takes part, each with the cameras that it lacks.
"""

import datetime
import json
import subprocess
import sys
import time
from pathlib import Path

from hosts_witness import Witness
from namespaces import World

from sagoma_tools.graph.network_settings import PROFILE_VARIABLE, profile_file
from stick_figure.body import Body
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

SERVER, FPS, CLIP_S = "server", 10.0, 3.0
BEGIN_S, LATE_S = 20.0, 5.0  # the first hosts have loaded by then, on a busy machine too; the last one starts later
WHOLE_SETS, PATIENCE_S = 30, 120.0
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
        witness = Witness(told)
        begin = datetime.datetime.now(datetime.UTC) + datetime.timedelta(seconds=BEGIN_S)
        start_at = ("--start-at", begin.isoformat(timespec="seconds"))
        logs = {host: (folder / f"{host}.log").open("w") for host in world.hosts}
        up(SERVER, "server", *start_at, stdout=logs[SERVER], stderr=logs[SERVER])
        for camera in cameras[:2]:
            up(camera, camera, *start_at, stdout=logs[camera], stderr=logs[camera])
        time.sleep(BEGIN_S + LATE_S)
        up("cam03", "cam03", *start_at, stdout=logs["cam03"], stderr=logs["cam03"])
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            first = next((n for n, each in enumerate(list(witness.sets)) if not each["missing"]), None)
            if first is not None and len(witness.sets) >= first + WHOLE_SETS:
                break
            time.sleep(0.2)
        early = [each["missing"] for each in witness.sets[: first or 0]]
        sets = [] if first is None else witness.sets[first : first + WHOLE_SETS]
        late = {"early": early, "missing": [each["missing"] for each in sets]}
        print(json.dumps(late | {"spread_ms": [each["spread_ms"] for each in sets]}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
