"""Animation of a machine running a program, as one HTML page. Nothing is imported here: only `draw` needs meshcat, which is slow."""
