"""Frequency responses and recorded hits to poles."""
