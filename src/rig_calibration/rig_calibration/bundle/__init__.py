"""Poses of all cameras from targets that several of them see: initialisation, sparse bundle adjustment, covariance."""
