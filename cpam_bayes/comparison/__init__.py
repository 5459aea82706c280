"""The paper's tables beside what this package computes: the question `paper`."""
