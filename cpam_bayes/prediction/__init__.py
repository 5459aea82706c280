"""The question `predict`: frequencies of another plate of a material whose posterior is stored."""
