"""One camera's focal length, principal point and lens distortion, from views of a board (thesis 6.1)."""
