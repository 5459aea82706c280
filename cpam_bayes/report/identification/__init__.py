"""What `identify` by the swarm shows."""
