"""Measured mode shapes: modes of a universal file, at nodes of the plate."""
