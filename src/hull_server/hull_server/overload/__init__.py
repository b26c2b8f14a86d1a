"""What the hull server does when the graph cannot process every frame set: all clients thin out by one rule."""
