"""The live page: what the graph sees and does, in any browser."""
