"""Diagnosis of this machine, and of its links to others."""
