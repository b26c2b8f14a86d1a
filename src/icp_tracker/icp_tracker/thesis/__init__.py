"""The thesis's method, as the baseline: hierarchical articulated ICP with Procrustes alignment (thesis 4.2, 4.3)."""
