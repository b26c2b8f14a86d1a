"""A body's sizes from the silhouettes' rims of many poses, while it is being tracked."""
