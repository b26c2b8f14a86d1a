"""Several persons in one volume: data association, a tracker for each, and who is who."""
