"""Reduced models of plates with a local change at any place."""
