"""Shared by all commands: options, checks of inputs and outputs, printing of results, and terminal handling."""
