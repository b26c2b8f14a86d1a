"""The wire format of GigE Vision 2.x between camera and client, pure and without dependencies."""
