"""A grasp: a hand, an object, and which fingers touch it where; and the search for one."""
