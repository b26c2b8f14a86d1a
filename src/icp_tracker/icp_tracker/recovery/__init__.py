"""Whether the track is good, which limb is not, and how to get it back."""
