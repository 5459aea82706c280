"""Trials of the diagnosis: effects hidden in simulated lists, oracles, statistics of the claims."""
