"""Sizes of causes and their uncertainty."""
