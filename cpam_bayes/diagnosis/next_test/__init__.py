"""Which further test would tell the causes apart best."""
