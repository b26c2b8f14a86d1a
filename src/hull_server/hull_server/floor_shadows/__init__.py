"""Resolves with all cameras together whether dark pixels are the person or floor in shadow.

A camera sends three kinds of foreground (``capture_rig.mask_levels``): sure pixels; candidates, whose texture says that
they are shadow; and attenuated pixels, which are the person unless other cameras know better. A cast shadow lies on the
floor z = 0, so all cameras that see a place of the floor see it equally attenuated. A leg stands above the floor: its
pixels fall on other floor places in every camera, bright or differently attenuated ones; and above that place on the
ray, all silhouettes agree on a body. So an attenuated pixel is shadow when

1. another camera sees its floor place equally attenuated, and no more cameras contradict (bright floor, another
   attenuation) than agree; cameras that see the person in front of it are not counted;
2. its ray does not meet the hull of all silhouettes higher than ``min_height_m``: that would be a leg in front of it;
3. most attenuated or sure pixels around it are shadow by 1 and 2, as one wrong pixel in one camera cuts the hull.

A candidate is background, unless more cameras contradict than agree and its ray does meet that hull: then it is the
body. The planar homography between views of the floor is that of Khan and Shah (ECCV 2006), who find feet with it. The
constants were chosen with bench/shadow_resolution.py of commit d6079d2.
"""

from .resolver import ShadowResolver

__all__ = ["ShadowResolver"]
