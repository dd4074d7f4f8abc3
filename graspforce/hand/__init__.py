"""What makes a hand: description files, URDF facts, the map from motors to joints, lint; the hands that ship in models/."""
