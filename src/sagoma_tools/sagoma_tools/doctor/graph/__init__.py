"""Diagnosis of the running graph, from what it says in a few seconds."""
