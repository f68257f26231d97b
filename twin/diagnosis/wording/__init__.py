"""What is said of it: text, page, pictures. Nothing is worked out here that the numbers do not have."""
