"""How large causes are, and how far off that may be."""
