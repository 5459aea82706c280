"""What the simulation gets wrong: causes weighed by evidence, the claim, the extended model, the gain."""
