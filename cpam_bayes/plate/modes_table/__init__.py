"""Tables of measured modes: rows as instruments write them, hits of a mode as one frequency."""
