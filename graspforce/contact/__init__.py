"""Contacts, friction cones, the grasp matrix, closure, and contact kinematics."""
