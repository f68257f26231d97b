"""APT cutter locations."""
