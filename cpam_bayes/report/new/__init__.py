"""What `new` shows."""
