"""Causes of a misfit weighed against each other: the claim, its gain, further tests."""
