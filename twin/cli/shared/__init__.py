"""What all commands share: their options, the checks before and the account after each, and how they speak to a terminal."""
