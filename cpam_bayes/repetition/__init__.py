"""The paper's noise study: perturbed frequencies inverted again and again, beside the posterior."""
