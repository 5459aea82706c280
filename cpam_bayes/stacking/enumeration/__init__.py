"""Every stacking sequence on the grid: computed one by one, or by the surrogate."""
