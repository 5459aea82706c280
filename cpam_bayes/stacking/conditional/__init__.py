"""The posterior of the constants given a stacking sequence, for stacks of sequences at once."""
