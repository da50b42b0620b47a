"""Training of what can be learned, with Lightning. Nothing imports this package."""
