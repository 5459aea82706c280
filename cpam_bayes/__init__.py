"""Elastic constants of composite plates from their natural frequencies."""

__version__ = "0.1.0"
