"""Joint rates from measured positions."""
