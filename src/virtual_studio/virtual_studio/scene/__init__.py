"""What is in the studio: the empty room, calibration boards, and the hands that move them."""
