"""Recordings of others into session folders: one package an importer, listed by name in ``table``."""
