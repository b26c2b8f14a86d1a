"""The wire format of GigE Vision 2.x, pure and without dependencies: what a camera and its client both speak."""
