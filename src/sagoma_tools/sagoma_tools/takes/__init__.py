"""Takes: recorded bags with what is known of each, and what can be done with them without losing anything."""
