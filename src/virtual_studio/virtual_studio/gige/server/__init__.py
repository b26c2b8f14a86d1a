"""The device side of GigE Vision: registers, control channel (GVCP), stream channel (GVSP), GenICam description."""
