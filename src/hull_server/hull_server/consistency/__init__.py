"""How the silhouettes of one instant agree: faulty and moved cameras, occluders, support for each foreground."""

EARLY = 0.1  # share of a period by which a frame set may come early: stamps jitter
