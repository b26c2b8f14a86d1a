"""Takes: recorded bags with their figures, and operations on them that lose nothing."""
