"""What `plates` shows, and the head of every screen."""
