"""The posterior over stacking sequences, the elastic constants marginalised."""
