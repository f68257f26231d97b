"""What follows from the causes that stand: doubts, gains, what could as well be, what to measure next."""
