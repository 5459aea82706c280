"""A plate with one local change of mass or stiffness at any place: its basis, and frequencies from it."""
