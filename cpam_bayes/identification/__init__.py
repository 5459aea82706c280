"""Constants and angles of one plate from its list."""
