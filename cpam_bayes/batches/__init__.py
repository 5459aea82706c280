"""The question `batch`: many plates, their limits, their scatter."""
