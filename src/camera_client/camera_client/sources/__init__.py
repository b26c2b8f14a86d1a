"""Sources of frames: GigE Vision cameras through Aravis, footage, supervision of a live camera, frame checks."""
