"""What the cameras say together before anything is carved: shadows, and cameras that contradict all others."""
