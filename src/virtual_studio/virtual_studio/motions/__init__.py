"""What the built-in person can do: activities that fade into each other, and where they put the body in the room."""
