"""The client side of GigE Vision, without any driver: discovery, features, pixel formats, clocks, triggers."""
