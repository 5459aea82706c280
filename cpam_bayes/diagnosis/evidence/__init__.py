"""Marginal likelihoods of hypotheses: screening, quadrature, probabilities."""
