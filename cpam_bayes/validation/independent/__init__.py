"""Truths for benchmarks from elements of their own: nothing here knows the package's mechanics or effects."""
