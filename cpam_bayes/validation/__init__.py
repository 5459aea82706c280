"""Checks of the methods by simulation: imported by studies and tests, by no command."""
