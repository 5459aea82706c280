"""What `export --to uff` shows."""
