"""A hand without an object: plant, joint-space controllers, recordings with their step responses, and plots."""
