"""What `diagnose` shows."""
