"""What `batch` shows."""
