"""Plate mechanics: the forms, the spaces that discretise them, operators, eigenpairs, convergence."""
