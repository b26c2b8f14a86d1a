"""Recordings of public data sets as session folders."""
