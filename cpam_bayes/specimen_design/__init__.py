"""The question `design`: which specimen and test would determine the constants."""
