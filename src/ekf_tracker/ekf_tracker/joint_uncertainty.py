"""How far the figure's joint may lie from a person's own, along the axes of the joint's stick.

A figure whose surface lies exactly on a person's still does not know where in the flesh that person's joint is, nor
what another source means by its name: a marker set, a neural network and a radiograph place a hip centimetres apart.
The deviations are round numbers from what is known of landmarks that are located from the outside:

- hip: centres regressed from the pelvis are 20 to 30 mm off (Bell, Pedersen & Brand 1990; Leardini et al., J. Biomech.
  32, 1999), mostly forward and up; here 19 mm altogether.
- neck: anything from the seventh vertebra to the notch of the breastbone, 10 cm in front of it; 21 mm altogether. The
  torso's centre is half way between neck and hips and has half of both.
- shoulder, elbow, knee, ankle: palpated landmarks differ by 10 to 20 mm between examiners, bony ones at the ankle
  least (Della Croce et al., Gait & Posture 21, 2005), and a joint's centre is the mean of two or more.
- head: the crown under hair, and a head that no other stick holds upright.
- hand: fingers are more or less bent, and the wrist, which the forearm's stick does not have, turns the hand.

They were rounded while looking at ``bench/covariance_coverage.py`` on the studio's and the three rendered sessions, the
real one with four cameras and the first of the mesh people: none of these is a proof of them.
"""

from __future__ import annotations

import numpy as np

# m; in the frame of the point's stick: torso, head, thigh, calf forward, left, up; arms with y along the arm
_TORSO, _HEAD, _NECK = (0.011, 0.005, 0.008), (0.014, 0.008, 0.014), (0.016, 0.006, 0.012)
_SHOULDER, _HIP, _ELBOW = (0.009, 0.008, 0.009), (0.014, 0.007, 0.011), (0.008, 0.008, 0.006)
_KNEE, _HAND, _FOOT = (0.007, 0.005, 0.007), (0.010, 0.012, 0.010), (0.007, 0.005, 0.007)

JOINT_SD_M = np.array(
    [
        *(_TORSO, _HEAD, _NECK),
        *(_SHOULDER, _SHOULDER, _HIP, _HIP),
        *(_ELBOW, _ELBOW, _KNEE, _KNEE, _HAND, _HAND, _FOOT, _FOOT),
    ]
)
"""(15, 3) standard deviations, m, in the order of `stick_figure.skeleton.POINT_NAMES`."""
