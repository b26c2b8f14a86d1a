"""The contest of sticks: clips of random and recorded motion, bounds, trackers, and rivals."""
