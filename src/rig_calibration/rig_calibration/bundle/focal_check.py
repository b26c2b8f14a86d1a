"""Do the views of several cameras agree with the focal lengths that were given?

One Gauss-Newton step away from the solution, with focal lengths and principal points of all cameras set free: were the
intrinsics right, it would not change them by more than their standard deviations. (A board that only one camera sees
tells little about them: a longer lens looks like a board farther away. Another camera knows where the board is.)
"""

from __future__ import annotations

import numpy as np

from .adjustment import huber_weights, normalised_lengths
from .displacement import whitened
from .fit import Fit
from .normal_equations import Free, NormalEquations, normal_equations, reduce, step
from .observations import Layout
from .projection import linearise

WIDE = 0.1  # of the focal length: standard deviation of what is assumed of all four beforehand
PINHOLE = 4


def focal_ratios(fit: Fit) -> dict[str, tuple[float, float]]:
    """By camera, the focal length that all views together ask for over the one given, and its standard deviation."""
    state, names = fit.adjusted.state, list(fit.problem.cameras)
    layout = Layout(len(names), fit.layout.targets, with_lens=True)
    used = fit.used.weighted(np.array(1 / fit.adjusted.scale))
    weighted = used.weighted(np.sqrt(huber_weights(normalised_lengths(state, used))))
    linear = whitened(linearise(state, weighted, with_lens=True), fit.displacement[fit.rows])
    equations = normal_equations(linear, weighted, layout, len(state.position))
    focal_px = np.sqrt(state.lens[:, 0] * state.lens[:, 1])
    free, U = fit.free(layout), equations.U.copy()
    shared = free.shared.copy()
    for row in range(len(names)):
        pinhole = np.arange(layout.size)[layout.lens(row)][:PINHOLE]
        shared[pinhole] = True
        U[pinhole, pinhole] += (WIDE * focal_px[row]) ** -2.0
    asked = NormalEquations(U, equations.W, equations.V, equations.g_shared, equations.g_poses)
    free = Free(shared, free.poses)
    change = step(asked, free, 0.0)[0]
    variance = np.zeros(layout.size)
    variance[shared] = np.diag(np.linalg.pinv(reduce(asked, free).S, rcond=1e-14, hermitian=True))
    found = {}
    for row, name in enumerate(names):
        focal = np.arange(layout.size)[layout.lens(row)][:2]
        ratio = float(np.mean(1 + change[focal] / state.lens[row, :2]))
        found[name] = ratio, float(np.sqrt(variance[focal].mean()) / focal_px[row])
    return found
