"""Rendering of what a camera sees: bodies, shadows, boards, lens, exposure and sensor noise."""
