"""The running graph: what it says in a few seconds, and what that means."""
