"""From parameters to natural frequencies: the converged model, its reduced basis, the store of models."""
