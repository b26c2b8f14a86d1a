"""The live page: the graph's cameras, persons and controls, in any browser."""
