"""Answers of a diagnosis beside its claim: detection limits, averaged constants."""
