"""Evaluation of tracks against the truth, as numbers, tables and pictures."""
