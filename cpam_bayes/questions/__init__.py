"""One module a question, named as its command."""
