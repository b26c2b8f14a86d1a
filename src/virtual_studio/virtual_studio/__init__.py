"""Virtual studio: a built-in articulated body in a room, seen by simulated cameras, written as session folders."""
