"""Selection of the causes and the unnamed patterns that explain the residuals."""
