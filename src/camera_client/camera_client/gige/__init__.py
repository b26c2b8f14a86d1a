"""What a GigE Vision camera asks of its client, without the camera: addresses, features, formats, clocks, triggers."""
