"""The first pose and the body's sizes: from a T-pose, a known body, a file or a session."""
