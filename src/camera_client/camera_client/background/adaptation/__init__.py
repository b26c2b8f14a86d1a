"""Background adaptation: the expected image follows light, noise, displacement and slow changes, frame by frame."""
