"""A plate as an ABAQUS-format input deck, and CalculiX runs of it through files."""
