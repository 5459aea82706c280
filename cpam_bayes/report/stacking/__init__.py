"""What `sequence` shows."""
