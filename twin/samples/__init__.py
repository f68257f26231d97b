"""What comes with `twin` to try it on, and the scripts that made it."""
