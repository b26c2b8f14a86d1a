"""Several persons in one volume: whose is what of the hull, and a tracker for each."""
