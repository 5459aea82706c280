"""Marginal likelihoods of hypotheses."""
