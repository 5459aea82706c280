"""What `predict` shows."""
