"""The sagoma command: bring the graph up, start, suspend and stop it, record, replay, evaluate."""
