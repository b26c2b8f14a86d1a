"""Lets every camera client of a running graph learn its background."""

from __future__ import annotations

from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from sagoma_bringup.node_spec import Role

from .service_calls import call_all
from .supervisor import Supervisor

TIMEOUT_S = 120.0


def learn_backgrounds(supervisor: Supervisor, timeout_s: float = TIMEOUT_S) -> dict[str, str]:
    """Call ~/learn_background of all cameras at once; the room must be empty. Returns what each one says.

    Raises InputError naming the cameras that refuse, and why, or that do not answer.
    """
    cameras = {spec.full_name: spec.label for spec in supervisor.graph if spec.role is Role.CAMERA}
    requests = {f"{name}/learn_background": Trigger.Request() for name in cameras}

    def done(services: set[str]) -> dict[str, Trigger.Response]:
        """Cameras whose diagnostics tell of a background, should the reply itself have been lost."""
        reports = {service: supervisor.board.report(service.rpartition("/")[0]) for service in services}
        texts = {service: report.values.get("background", "") for service, report in reports.items() if report}
        return {service: Trigger.Response(success=True, message=text) for service, text in texts.items() if text}

    replies = call_all(supervisor.node, Trigger, requests, timeout_s, inferred=done)
    by_camera = {cameras[service.rpartition("/")[0]]: reply for service, reply in replies.items()}
    refused = {
        camera: "no answer" if reply is None else reply.message
        for camera, reply in by_camera.items()
        if reply is None or not reply.success
    }
    if refused:
        raise InputError("; ".join(f"{camera}: {text}" for camera, text in refused.items()),
                         where="learning the background", remedy="Clear the scene and try again.")  # fmt: skip
    return {camera: reply.message for camera, reply in by_camera.items()}
