"""The log probability of a plate's parameters, its optima, integrals and draws."""
