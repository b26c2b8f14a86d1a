"""Bags: recording, reading, recovery, and replay with recorded timing or in lockstep."""
