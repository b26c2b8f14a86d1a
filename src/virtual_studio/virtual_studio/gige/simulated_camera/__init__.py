"""A simulated camera: its features, clock and triggers, sensor, and acquisition."""
