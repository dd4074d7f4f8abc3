"""The fastest move along a given path."""
