"""The local page: a plate file on screen, with its constants and diagnosis updated while the user types."""
