"""A surrogate of the log evidence as a function of a sequence's features."""
