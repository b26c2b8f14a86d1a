"""Checks the silhouettes of one camera: arrival, plausible content, and the rig's calibration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from statistics import median

from ..findings import Finding, error, note, ok, warning
from .facts import Canvas, NodeFacts, SilhouetteFacts
from .node_checks import ACTIVE, BIG_MESSAGES

PERSON_SHARE = 0.003  # of the canvas: a person fills ten times as much
NOTHING = 1e-5
FLOODED = 0.5
ENOUGH_MASKS = 10
SAME_PX = 0.01
LOST = 0.02
OLD_S, EARLY_S = 1.0, 5e-3
PACKET_BYTES = 1400
BACKGROUND = "Learn the background of the empty room again: sagoma background --cameras {}"


def sees_person(facts: SilhouetteFacts) -> bool:
    """Return whether most of its masks have a plausible share of foreground."""
    return bool(facts.shares) and PERSON_SHARE <= median(facts.shares) < FLOODED


def is_nearly_blank(facts: SilhouetteFacts) -> bool:
    """Return whether its masks are as good as empty."""
    return bool(facts.shares) and median(facts.shares) < PERSON_SHARE


def check_silhouettes(
    facts: SilhouetteFacts, node: NodeFacts | None, others_see: Sequence[str], rig: Canvas | None, rig_file: str = ""
) -> Iterator[Finding]:
    """Check one camera's silhouettes.

    others_see : the other cameras that see a person. rig : the canvas that the rig gives this camera, when one is
    known; rig_file : the one that its client was given.
    """
    if facts.publishers > 1:
        remedy = "Stop all but one client of this camera."
        yield error("silhouettes.duplicate_publisher", f"{facts.publishers} nodes publish them", remedy)
    if not facts.masks:
        yield from _check_absence(facts, node)
        return
    yield from _check_canvas(facts, rig, rig_file)
    yield from _check_way(facts)
    yield from _check_content(facts, others_see)


def check_canvas_agrees(canvas: Canvas, rig: Canvas) -> str:
    """Differences of the canvas that a camera publishes from the rig's, in words; "" when there are none."""
    if (canvas.width, canvas.height) != (rig.width, rig.height):
        return f"its canvas is {canvas.width} x {canvas.height}, the rig's {rig.width} x {rig.height} pixels"
    differences = [
        f"{name} {mine:.2f}, in the rig {theirs:.2f}"
        for name, mine, theirs in (
            ("fx", canvas.fx, rig.fx),
            ("fy", canvas.fy, rig.fy),
            ("cx", canvas.cx, rig.cx),
            ("cy", canvas.cy, rig.cy),
        )
        if abs(mine - theirs) > SAME_PX
    ]
    return ", ".join(differences)


def _check_absence(facts: SilhouetteFacts, node: NodeFacts | None) -> Iterator[Finding]:
    uncalibrated = facts.canvas is not None and facts.canvas.fx == 0  # as camera_info says it (REP-104)
    if node is None or node.state != ACTIVE or not facts.publishers or uncalibrated:
        return  # the node's findings say so
    if facts.infos:
        yield error(
            "silhouettes.not_arriving", f"its camera_info arrives ({facts.infos}), its silhouettes do not", BIG_MESSAGES
        )
    elif float(node.values.get("rate_hz", "0")) > 0:
        yield error(
            "silhouettes.not_arriving", f"it sends {node.values['rate_hz']} a second, none arrives here", BIG_MESSAGES
        )
    else:
        yield warning("silhouettes.none_sent", "it sends none", "See its message; without a background there are none.")


def _check_canvas(facts: SilhouetteFacts, rig: Canvas | None, rig_file: str) -> Iterator[Finding]:
    canvas = facts.canvas
    if canvas is None:
        yield warning("camera_info.missing", "none arrives beside the silhouettes", "Is camera_client the publisher?")
        return
    if any(size != (canvas.width, canvas.height) for size in facts.sizes):
        sizes = " and ".join(f"{width} x {height}" for width, height in facts.sizes)
        text = f"they are {sizes}, camera_info says {canvas.width} x {canvas.height} pixels"
        yield error("silhouettes.size_differs", text, "Two clients of one name, or a damaged one: restart it.")
    if rig is None:
        return
    differs = check_canvas_agrees(canvas, rig)
    if differs:
        where = f" (its rig_file: {rig_file})" if rig_file else ""
        yield error(
            "camera_info.differs",
            f"made with another calibration than the rig file: {differs}{where}",
            "Copy the newer of both rig files to both machines, configure both again; a calibration set "
            "by set_camera_info belongs into rig.yaml too.",
        )
    else:
        yield ok("camera_info", "agrees with the rig file")


def _check_way(facts: SilhouetteFacts) -> Iterator[Finding]:
    sent = facts.masks + facts.lost
    if facts.lost > LOST * sent:
        large = " (larger than one packet)" if facts.largest_bytes > PACKET_BYTES else ""
        yield warning(
            "network.loss", f"{facts.lost} of {sent} silhouettes{large} got lost on the way here", BIG_MESSAGES
        )
    if facts.age_s is not None and facts.age_s < -EARLY_S:
        text = f"its frames are stamped {-facts.age_s:.3f} s ahead of this machine's clock"
        yield error("stamps.ahead", text, "chrony or PTP on all machines; for PTP stamps check tai_utc_offset_s.")
    elif facts.age_s is not None and facts.age_s > OLD_S:
        remedy = "Its clock is behind (see clock), footage plays late, or the machine is too busy."
        yield warning("latency.old", f"its silhouettes are {facts.age_s:.1f} s old when they arrive", remedy)


def _check_content(facts: SilhouetteFacts, others_see: Sequence[str]) -> Iterator[Finding]:
    learn = BACKGROUND.format(facts.camera)
    share = median(facts.shares) if facts.shares else 0.0
    text = f"{100 * share:.1f} % foreground, {facts.rate_hz:.1f} a second"
    if facts.bad:
        yield error("silhouettes.undecodable", facts.bad, "The messages are damaged: see its log, and the network.")
    elif share >= FLOODED:
        yield error("silhouettes.flooded", f"flooded: {text}", f"The light or the camera was changed. {learn}")
    elif facts.masks >= ENOUGH_MASKS and not facts.changes and share > NOTHING:
        remedy = "Cycle the camera's power; see its client's message."
        yield error("silhouettes.frozen", f"frozen: the same one {facts.masks} times ({text})", remedy)
    elif share < NOTHING and others_see:
        remedy = f"Lens cap, wrong direction, or a person was in the room while it learned. {learn}"
        yield warning("silhouettes.blank", f"blank, while {', '.join(others_see)} see a person", remedy)
    elif share < PERSON_SHARE and others_see:
        yield note(
            "silhouettes.nearly_blank",
            f"nearly blank ({text}), while {', '.join(others_see)} see a person",
            "Nothing, if nobody is in its view.",
        )
    else:
        yield ok("silhouettes", text)
