"""What a sampled posterior is worth: what determines it, what moves it, whether it fits its data."""
