"""Mathematics that knows no machine: spatial algebra, bases of curves, covariances, what data can decide."""
