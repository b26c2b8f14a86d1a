"""How far the figure's joint may lie from a person's own, along the axes of the joint's stick.

A figure whose surface lies exactly on a person's still does not know where in the flesh that person's joint is, nor
what another source means by its name: a marker set, a neural network and a radiograph place a hip centimetres apart.
The deviations are round numbers from what is known of landmarks that are located from the outside:

- hip: centres regressed from the pelvis are 20 to 30 mm off (Bell, Pedersen & Brand 1990; Leardini et al., J. Biomech.
  32, 1999), those of pose networks 30 to 50 mm (Needham et al., Sci. Rep. 11, 2021), mostly forward and up.
- neck: anything from the seventh vertebra to the notch of the breastbone, 10 cm in front of it: evenly spread, 29 mm.
  The torso's centre is half way between neck and hips and has half of both.
- shoulder, knee, ankle: palpated landmarks differ by 10 to 20 mm between examiners, bony ones at the ankle least (Della
  Croce et al., Gait & Posture 21, 2005), and a joint's centre is the mean of two or more; networks put the knee as far
  off as the hip.
- head: the crown under hair, and a head that no other stick holds upright.
- hand: a fist is up to 85 mm shorter than the stretched hand that ends the stick: evenly spread, 25 mm along it. It
  turns about the wrist, which the forearm's stick does not have.
- elbow: as the shoulder, and a fist pushes the forearm's stick back.

They were rounded while looking at their coverage on the studio's and the three rendered sessions, the
real one with four cameras and the first of the mesh people: none of these is a proof of them. For rendered people,
whose joints are those of the surfaces that the figure's was learnt from, they are too large; for the real one not.
"""

from __future__ import annotations

import numpy as np

# m; in the frame of the point's stick: torso, head, thigh, calf forward, left, up; arms with y along the arm
_TORSO, _HEAD, _NECK = (0.018, 0.008, 0.009), (0.014, 0.010, 0.014), (0.029, 0.009, 0.012)
_SHOULDER, _HIP, _ELBOW = (0.013, 0.009, 0.013), (0.022, 0.009, 0.014), (0.020, 0.016, 0.012)
_KNEE, _HAND, _FOOT = (0.013, 0.006, 0.013), (0.014, 0.025, 0.018), (0.014, 0.007, 0.011)

# Thresholds: from regressions of hip centres and the precision of palpated landmarks (Bell et al. 1990; Leardini et
# al. 1999; Della Croce et al. 2005); judgement.
JOINT_SD_M = np.array(
    [
        *(_TORSO, _HEAD, _NECK),
        *(_SHOULDER, _SHOULDER, _HIP, _HIP),
        *(_ELBOW, _ELBOW, _KNEE, _KNEE, _HAND, _HAND, _FOOT, _FOOT),
    ]
)
"""(15, 3) standard deviations, m, in the order of `stick_figure.skeleton.POINT_NAMES`."""
