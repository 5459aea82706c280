"""Questions to the posterior over stacking sequences."""
