"""What is asked of a posterior over stacking sequences once it is there."""
