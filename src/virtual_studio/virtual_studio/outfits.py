"""Dresses people in clothes darker than the room, lighter, or of its own colour, in grey and in colour."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .people import HAIR, SHIRT, SHOES, SKIN, SLEEVE, TROUSERS, Capsules

MEAN_SHADING = 0.62
"""Light that an upright body of albedo 1 reflects on average (`rendering.capsules.lambert`); the room is painted with
what it reflects, so clothes of the room's colour have its grey over this as their albedo."""
SKIN_BGR, HAIR_BGR = (0.72, 0.93, 1.35), (0.8, 1.0, 1.2)
"""Blue, green and red over grey, each with a mean of 1."""

Bgr = tuple[float, float, float]


@dataclass(frozen=True)
class Cloth:
    """A cloth that reflects so much of the light where walls reflect 0.6, and its colour with a mean of 1."""

    light: float
    bgr: Bgr = (1.0, 1.0, 1.0)

    @property
    def albedo_bgr(self) -> NDArray[np.float64]:
        return self.light / MEAN_SHADING * np.array(self.bgr)


@dataclass(frozen=True)
class Outfit:
    """What a person wears; skin and hair stay a person's."""

    shirt: Cloth
    sleeve: Cloth
    trousers: Cloth
    shoes: Cloth

    def albedo_bgr(self, capsules: Capsules) -> NDArray[np.float64]:
        """Returns the albedo (P, 3), BGR, of each part of a body."""
        worn = {
            SKIN: SKIN * np.array(SKIN_BGR),
            HAIR: HAIR * np.array(HAIR_BGR),
            SHIRT: self.shirt.albedo_bgr,
            SLEEVE: self.sleeve.albedo_bgr,
            TROUSERS: self.trousers.albedo_bgr,
            SHOES: self.shoes.albedo_bgr,
        }
        return np.array([worn[albedo] for albedo in capsules.albedo])

    def dress(self, capsules: Capsules) -> Capsules:
        """Returns a body in these clothes, as a grey camera sees them."""
        return capsules._replace(albedo=self.albedo_bgr(capsules).mean(axis=1))


BLUE, GREEN, BROWN = (1.35, 0.95, 0.70), (0.85, 1.30, 0.85), (0.75, 0.95, 1.30)
OUTFITS: Mapping[str, Outfit] = {
    "dark": Outfit(Cloth(0.10, BLUE), Cloth(0.11, BLUE), Cloth(0.06), Cloth(0.05)),
    "middle": Outfit(Cloth(0.36, GREEN), Cloth(0.40, GREEN), Cloth(0.30, BLUE), Cloth(0.12, BROWN)),
    "light": Outfit(Cloth(0.84), Cloth(0.88), Cloth(0.78, (0.92, 1.0, 1.08)), Cloth(0.70)),
    "room": Outfit(Cloth(0.60), Cloth(0.60), Cloth(0.55, (0.74, 0.98, 1.28)), Cloth(0.52, (0.74, 0.98, 1.28))),
}
"""By how they look in the studio's room, whose walls reflect 0.6 and whose floor, brown, 0.55."""
