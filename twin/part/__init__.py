"""The part: what a program on a machine with errors makes of it, and what a drawing's tolerances say of that."""
