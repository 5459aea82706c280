"""Many plates: shared models, rows, limits, the scatter of a material."""
