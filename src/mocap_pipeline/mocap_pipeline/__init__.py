"""The whole pipeline on one page: segment, resolve shadows, carve, slice, fit, filter, predict."""
