"""Bags: recording, reading, recovery, and replay with the timing of exposures or in lockstep."""
