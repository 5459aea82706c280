"""Modal analysis: poles from frequency responses and recorded hits."""
