"""Questions: one module each, named after its command."""
