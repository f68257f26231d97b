"""Heidenhain plain language."""
