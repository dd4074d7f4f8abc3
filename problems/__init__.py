"""Force problems with known answers."""
