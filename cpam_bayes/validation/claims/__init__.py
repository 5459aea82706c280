"""A benchmark of what is claimed: answers to lists, their scores, an oracle, and simpler methods."""
