"""EKF tracker: 15 reference points in, joint states with covariance out."""
