"""Text on the page, which reads markdown."""

from __future__ import annotations

SPECIAL = "\\`*_{}[]<>#|~"


def escape(text: str) -> str:
    """Return text that markdown shows as it is."""
    return "".join(f"\\{char}" if char in SPECIAL else char for char in text)
