"""The tool's pose: from commands with and without errors, its inverse, and its uncertainty."""
