"""What `identify --backend emcee` shows."""
