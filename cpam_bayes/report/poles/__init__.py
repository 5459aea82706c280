"""What `poles` shows."""
