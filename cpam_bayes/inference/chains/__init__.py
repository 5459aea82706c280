"""Ensembles of chains by emcee: moves to proposals, convergence, the store of rounds, draws for arviz."""
