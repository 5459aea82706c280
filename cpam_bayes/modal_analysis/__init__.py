"""From frequency responses or recorded hits to the poles of a plate, for a table of modes."""
