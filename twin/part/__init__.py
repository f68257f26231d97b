"""The part cut by a program on a machine with errors, and the tolerances of its drawing."""
