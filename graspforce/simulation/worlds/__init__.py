"""Worlds: how hand, object and contacts differ from what a controller is told, and plants in them."""
