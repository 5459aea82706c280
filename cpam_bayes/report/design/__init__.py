"""What `design` shows."""
