"""How far off the tool may be: at one pose, as a budget of contributions, over drawn machines."""
