"""Frequencies of a plate from its parameters."""
