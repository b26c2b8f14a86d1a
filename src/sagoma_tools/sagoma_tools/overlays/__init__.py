"""People drawn over the pictures of cameras, as pictures and as videos."""
