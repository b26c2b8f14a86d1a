"""Why a hull shows no pose to start from, in words for the person in front of the cameras."""

from __future__ import annotations


class Refusal(Exception):
    """Raised inside a measurement as soon as it is clear that there is nothing to measure; ``reason`` says why."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


def reasons_of_bodies(reasons: dict[int, str]) -> str:
    """One sentence for the reasons by which each body, by its number, was refused."""
    if len(reasons) == 1:
        return next(iter(reasons.values()))
    return "; ".join(f"body {number}: {reason}" for number, reason in sorted(reasons.items())) or "no hull"
