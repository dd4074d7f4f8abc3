"""Base of all other packages: errors, checks of input, frozen records, JSON, and the compiled module."""
