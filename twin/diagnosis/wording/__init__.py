"""A diagnosis in words and plots: terminal text, notebook table, HTML page."""
