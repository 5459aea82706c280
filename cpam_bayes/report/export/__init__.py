"""What `export` shows."""
