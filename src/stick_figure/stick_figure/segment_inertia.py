"""Mass, centre and moments of inertia of the sticks, for physics: segments' shares of the mass, shapes of the surface.

The shares are those of de Leva (J. Biomech. 29, 1996, table 4: Zatsiorsky's data, mean of women and men); within a
segment the mass is spread evenly over the capsules of the body's surface, so that it follows the person's build.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .body import Body
from .body_surface import BodySurface
from .rotations import Array

AVERAGE_BMI = 22.0
"""kg/m^2, the middle of the WHO's normal range."""
MASS_SHARES = np.array([43.015, 6.81, 2.63, 2.63, 14.47, 14.47, 2.085, 2.085, 5.90, 5.90])
MASS_SHARES /= MASS_SHARES.sum()
"""(10,) of the sticks: trunk, head with neck, upper arms, thighs, forearms with hands, calves with feet."""
DISCS = 64  # into which a capsule is cut: its inertia is then right to a thousandth


class SegmentInertia(NamedTuple):
    """Mass, kg; centre of mass (3,) m, in the stick's frame from its start; inertia (3, 3) kg m^2 about the centre."""

    mass: float
    centre: Array
    inertia: Array


def segment_inertias(body: Body, mass_kg: float | None = None) -> list[SegmentInertia]:
    """Return the inertia of each stick of a body; ``mass_kg`` : of the person, else that of an average BMI."""
    surface, mass = BodySurface.of(body), AVERAGE_BMI * body.stature**2 if mass_kg is None else mass_kg
    found = []
    for stick, share in enumerate(MASS_SHARES):
        own = surface.stick == stick
        solids = [
            _capsule(*ends) for ends in zip(surface.start[own], surface.end[own], surface.radii[own], strict=True)
        ]
        volumes = np.array([volume for volume, _, _ in solids])
        masses, centres = share * mass * volumes / volumes.sum(), np.array([centre for _, centre, _ in solids])
        centre = masses @ centres / masses.sum()
        about_own = sum(m * per_mass for m, (_, _, per_mass) in zip(masses, solids, strict=True))
        offsets = centres - centre
        moved = np.einsum("k,ki,kj->ij", masses, offsets, offsets)
        found.append(SegmentInertia(float(share * mass), centre, about_own + np.trace(moved) * np.eye(3) - moved))
    return found


def _capsule(start: Array, end: Array, radii: Array) -> tuple[float, Array, Array]:
    """Return the volume, m^3, of a tapered capsule, its centre (3,) m, and its inertia about that (3, 3) m^2 per kg."""
    length = max(float(np.linalg.norm(end - start)), 1e-9)
    direction = (end - start) / length
    edges = np.linspace(-radii[0], length + radii[1], DISCS + 1)
    s, width = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    beyond = np.maximum(np.maximum(-s, s - length), 0.0)  # in the ball at either end
    square = np.interp(s, (0.0, length), radii) ** 2 - beyond**2
    share = square / square.sum()
    middle, axial = float(share @ s), 0.5 * float(share @ square)
    across = 0.5 * axial + float(share @ (s - middle) ** 2)
    inertia = across * np.eye(3) + (axial - across) * np.outer(direction, direction)
    return float(np.pi * width * square.sum()), start + middle * direction, inertia
