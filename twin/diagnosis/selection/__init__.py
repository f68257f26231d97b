"""Which causes and which patterns without a name account for the misfit."""
