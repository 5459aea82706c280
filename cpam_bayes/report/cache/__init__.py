"""What `cache` shows."""
