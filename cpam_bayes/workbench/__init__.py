"""The local page: a plate file on a screen, with its constants and its diagnosis while one types."""
