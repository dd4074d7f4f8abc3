"""Planning processes."""
