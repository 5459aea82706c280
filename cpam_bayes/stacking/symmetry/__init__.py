"""Stacking sequences that no frequency can tell apart."""
