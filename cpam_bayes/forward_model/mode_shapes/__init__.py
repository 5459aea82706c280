"""Mode shapes at the nodes of a test: pairing by modal assurance, universal files of predicted modes."""
