"""What is shown and written: screens, JSON documents, figures, files, progress.

Nothing is imported here, so that matplotlib loads for figures alone.
"""
