"""Identification of joint friction from a recorded motion."""
