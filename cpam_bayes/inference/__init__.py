"""Back ends that turn measured frequencies into constants.

Nothing is imported here, so that the command line loads only the back end it was asked for.
"""
