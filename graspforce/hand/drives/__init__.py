"""Drives, tendons and friction of the joints of a hand."""
