"""The readings as they are judged: placed, with their scatter, whitened, and with what every candidate would do to them."""
