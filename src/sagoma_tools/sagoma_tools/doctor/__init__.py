"""Diagnosis of machine, network, cameras, rig and running graph: facts are collected, judged, shown with remedies."""
