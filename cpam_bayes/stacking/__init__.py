"""The posterior over stacking sequences."""
