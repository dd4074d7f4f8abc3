"""Detection of slip from kinematic and force evidence."""
