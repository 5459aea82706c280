"""What `forward` and `export` show."""
