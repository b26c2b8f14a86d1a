"""Scenes that simulated cameras look at live: rendered, or played from a session."""
