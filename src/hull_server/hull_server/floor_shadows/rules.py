"""Labels a camera's uncertain pixels by the floor in the other cameras (rule 1) and by the hull of all (rule 2)."""

from __future__ import annotations

import math

from capture_rig.kernel import kernel, njit
from capture_rig.mask_levels import FLOOR_REACH_M

from .labels import STRIDE, YES
from .scene import ATTENUATED, CANDIDATE, EMPTY, SURE, UNSEEN, level_of

# Thresholds: chosen with shadow_resolution.py among the benches of commit d6079d2.
TOLERANCE = 1  # attenuation steps of a tenth by which two cameras may differ and agree
RAY_STEP_M = 0.03  # half of a forearm


@njit(cache=True, nogil=True, error_model="numpy")
def label_pixels(scene, levels, bodies, camera, box, seeing, min_height, floor_px, labels):
    """Write the ``labels`` of one camera's attenuated pixels and candidates by rules 1 and 2.

    ``levels`` (N, H, W); ``bodies`` (N, 4): a box that holds each camera's pixels that may be the person; ``box`` of
    the pixels to test; boxes are (left, top, right, bottom). ``floor_px`` (N, 3) is scratch memory: the homogeneous
    pixel of the tested floor place in every camera.
    """
    left, top, right, bottom = box
    G = scene.floor
    for v in range(top, bottom, STRIDE):
        for u in range(left, right, STRIDE):
            level = levels[camera, v, u]
            kind = scene.kind[level]
            if kind < CANDIDATE:
                continue
            row, column = (v - top) // STRIDE, (u - left) // STRIDE
            if kind == CANDIDATE:
                labels.candidate[row, column] = YES
            else:
                labels.foreground[row, column] = YES
            if kind == SURE:
                continue
            # where the pixel's ray meets the floor
            w = G[camera, 2, 0] * u + G[camera, 2, 1] * v + G[camera, 2, 2]
            x = (G[camera, 0, 0] * u + G[camera, 0, 1] * v + G[camera, 0, 2]) / w
            y = (G[camera, 1, 0] * u + G[camera, 1, 1] * v + G[camera, 1, 2]) / w
            if not (scene.low[0] - FLOOR_REACH_M < x < scene.high[0] + FLOOR_REACH_M):
                continue
            if not (scene.low[1] - FLOOR_REACH_M < y < scene.high[1] + FLOOR_REACH_M):
                continue
            for other in range(len(levels)):
                P = scene.P[other]
                for k in range(3):
                    floor_px[other, k] = P[k, 0] * x + P[k, 1] * y + P[k, 3]
            if kind == ATTENUATED:
                if _is_in_question(scene, levels, camera, level, floor_px):
                    on_body = _meets_hull(scene, levels, bodies, camera, (x, y), seeing, min_height, floor_px)
                    labels.shadow[row, column] = not on_body
            elif _meets_hull(scene, levels, bodies, camera, (x, y), seeing, min_height, floor_px):
                labels.undecided[row, column] = YES
                labels.body[row, column] = _is_in_question(scene, levels, camera, level, floor_px)


@kernel
def _is_in_question(scene, levels, camera, own, floor_px):
    """Check whether the other cameras' view of a floor place speaks against the kind of level ``own`` (rule 1).

    The person (attenuated) is in question when a camera agrees that it is floor so attenuated, and no more contradict;
    shadow (a candidate) when more contradict than agree. Cameras that can change nothing any more are not asked.
    """
    attenuated, cameras = scene.kind[own] == ATTENUATED, len(levels)
    agree, contradict, left = 0, 0, cameras - 1
    for other in range(cameras):
        if other == camera:
            continue
        left -= 1
        f = floor_px[other]
        level = level_of(levels[other], f[0], f[1], f[2])
        kind = scene.kind[level]
        if kind == EMPTY:
            contradict += 1
        elif kind in (CANDIDATE, ATTENUATED):
            more = scene.attenuation[level, 0] - scene.attenuation[own, 1] > TOLERANCE
            less = scene.attenuation[own, 0] - scene.attenuation[level, 1] > TOLERANCE
            if more or less:
                contradict += 1
            else:
                agree += 1
        if contradict > agree + left if attenuated else contradict + left <= agree:
            return False
    return agree > 0 or not attenuated


@kernel
def _meets_hull(scene, levels, bodies, camera, floor, seeing, min_height, floor_px):
    """Check whether the ray from ``floor`` (x, y) to the camera meets the hull of the others above ``min_height``."""
    x, y = floor
    dx, dy, cz = scene.centres[camera, 0] - x, scene.centres[camera, 1] - y, scene.centres[camera, 2]
    start, end = min_height / cz, min(scene.high[2] / cz, 1.0)
    start, end = _clip(x, dx, scene.low[0], scene.high[0], start, end)
    start, end = _clip(y, dy, scene.low[1], scene.high[1], start, end)
    for other in range(len(levels)):
        if other != camera and start <= end:
            ends = floor_px[other], scene.epipoles[other, camera]
            start, end = _clip_to_body(scene.whole[other], bodies[other], ends, start, end)
    step = RAY_STEP_M / math.sqrt(dx * dx + dy * dy + cz * cz)
    t, vetoed_by = start, 0
    while t <= end:
        if vetoed_by != camera:  # most places are vetoed by the camera that vetoed the one before
            ends = floor_px[vetoed_by], scene.epipoles[vetoed_by, camera]
            t = _first_without_veto(levels[vetoed_by], scene.kind, ends, t, end, step)
            if t > end:
                return False
        vetoed_by = _vetoed_by(scene, levels, camera, floor_px, t, seeing, vetoed_by)
        if vetoed_by < 0:
            return True
        t += step
    return False


@kernel
def _first_without_veto(levels, kinds, ends, t, end, step):
    """Return the first of the places t, t + step, ... that one camera (H, W) does not veto, or one beyond the end.

    ends : homogeneous pixels (3,) of the floor place and of the camera whose ray it is.
    """
    (f0, f1, f2), (e0, e1, e2) = (ends[0][0], ends[0][1], ends[0][2]), (ends[1][0], ends[1][1], ends[1][2])
    while t <= end:
        s = 1.0 - t
        kind = kinds[level_of(levels, s * f0 + t * e0, s * f1 + t * e1, s * f2 + t * e2)]
        if kind not in (EMPTY, CANDIDATE):
            return t
        t += step
    return t


@kernel
def _clip(origin, direction, low, high, start, end):
    """Clip start .. end to where origin + t direction lies between low and high."""
    if abs(direction) < 1e-9:
        return (start, end) if low <= origin <= high else (1.0, 0.0)
    t0, t1 = (low - origin) / direction, (high - origin) / direction
    return max(start, min(t0, t1)), min(end, max(t0, t1))


@kernel
def _clip_to_body(whole, body, ends, start, end):
    """Clip start .. end to where a camera may show the person; only where it sees all of the ray.

    whole, body : boxes of pixels that the camera sees, and that may be the person. ends : homogeneous pixels (3,) of
    the floor place and of the camera whose ray it is.
    """
    if not (_is_inside(ends, whole, start) and _is_inside(ends, whole, end)):
        return start, end
    for axis in range(2):
        for side in range(2):  # of pixels whose middles are whole numbers
            edge, sign = body[axis + 2 * side] - 0.5, 1.0 - 2.0 * side
            at_floor = sign * (ends[0][axis] - edge * ends[0][2])
            at_camera = sign * (ends[1][axis] - edge * ends[1][2])
            start, end = _clip(at_floor, at_camera - at_floor, 0.0, math.inf, start, end)
    return start, end


@kernel
def _is_inside(ends, box, t):
    """Check that the place ``t`` between two homogeneous pixels is before the camera and inside a box of pixels."""
    f, e, s = ends[0], ends[1], 1.0 - t
    u, v, w = s * f[0] + t * e[0], s * f[1] + t * e[1], s * f[2] + t * e[2]
    return w > 0.0 and box[0] * w <= u <= (box[2] - 1) * w and box[1] * w <= v <= (box[3] - 1) * w


@kernel
def _vetoed_by(scene, levels, camera, floor_px, t, seeing, first):
    """Return a camera that has no foreground at share ``t`` of the way to the camera, tried from ``first`` on.

    -1 when all others that see it have foreground there, and enough see it; ``camera`` when too few see it.
    """
    count, other = 1, first
    for _ in range(len(levels)):
        if other != camera:
            kind = scene.kind[_level_at(scene, levels, other, camera, floor_px, t)]
            if kind in (EMPTY, CANDIDATE):
                return other
            if kind != UNSEEN:
                count += 1
        other = other + 1 if other + 1 < len(levels) else 0
    return -1 if count >= seeing else camera


@kernel
def _level_at(scene, levels, other, camera, floor_px, t):
    """Return the level in camera ``other`` at share ``t`` of the way from the floor place to ``camera``."""
    e, f, s = scene.epipoles[other, camera], floor_px[other], 1.0 - t
    return level_of(levels[other], s * f[0] + t * e[0], s * f[1] + t * e[1], s * f[2] + t * e[2])
