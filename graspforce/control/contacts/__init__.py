"""What the contacts of a grasp allow: mobility, constraints, conditions and slip reflex."""
