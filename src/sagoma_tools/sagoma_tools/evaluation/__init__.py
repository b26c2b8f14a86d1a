"""How good was it: tracks against truth, as numbers, tables and pictures."""
