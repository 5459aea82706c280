"""Plates as affine operators, discretised by Ritz or finite elements."""
