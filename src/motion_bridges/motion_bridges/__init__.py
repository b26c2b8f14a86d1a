"""Live motion for other programs: VMC (OSC), Lab Streaming Layer, joint angles of the ISB."""
