"""One plate, one frequency list: the constants as a point estimate or as a posterior."""
