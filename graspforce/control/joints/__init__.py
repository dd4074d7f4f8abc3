"""Control laws of joints without an object, and their commands."""
