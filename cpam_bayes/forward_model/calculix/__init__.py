"""A plate as an ABAQUS-format input deck, and CalculiX run on it through files."""
