"""What is said with a claim: its gain, its constants, its sensitivity to priors, what could be seen."""
