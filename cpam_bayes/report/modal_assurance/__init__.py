"""How measured mode shapes are paired with a model's, wherever a result shows it."""
