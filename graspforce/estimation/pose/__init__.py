"""Object pose from contacts and cameras."""
