"""Silhouettes' rims as rays that touch the body."""
