"""Rendering of camera images: bodies, shadows, boards, lens, exposure and sensor noise."""
