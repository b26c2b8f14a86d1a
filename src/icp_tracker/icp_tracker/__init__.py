"""ICP tracker: centerline points in, the stick figure's 15 reference points with covariance out."""
