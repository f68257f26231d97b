"""Heidenhain plain-language programs."""
