"""Forward models: frequencies of a plate from its parameters."""
