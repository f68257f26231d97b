"""Simple lines of programs, read and written many at once with arrays or compiled code."""
