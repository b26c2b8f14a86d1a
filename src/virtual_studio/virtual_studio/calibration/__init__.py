"""Footage to calibrate the studio's cameras with: boards and a wand, held, carried and laid down in the room."""
