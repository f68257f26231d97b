"""What was measured: the table, the instruments, what they read of a machine, and the evaluations of ISO 230."""
