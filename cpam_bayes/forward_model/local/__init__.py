"""Reduced models of changes at any place of a plate."""
