"""Discretisations of a plate: Rayleigh-Ritz and finite elements behind one protocol."""

from cpam_bayes.mechanics.spaces.ritz import Quadrature, Space

__all__ = ["Quadrature", "Space"]
