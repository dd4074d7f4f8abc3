"""Control: the torques that make a hand, and the object in it, move as wanted."""
