"""Where the tool is: forward with and without errors, the Newton step, the inverse, the branches of a machine."""
