"""This machine, and the ways from it to others."""
