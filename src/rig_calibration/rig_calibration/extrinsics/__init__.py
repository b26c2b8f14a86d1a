"""Where the cameras stand in the room: floor board, world frame, volume, verdict (thesis 6.1)."""
