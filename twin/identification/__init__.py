"""From measured points to error motions, with their uncertainty."""
