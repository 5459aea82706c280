"""What `paper` shows."""
