"""Particle swarms: the paper's PSO for constants and FPSO for ply angles."""
