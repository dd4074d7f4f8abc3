"""The phases of a grasp: from an empty hand to an object on a table, and to its release."""
