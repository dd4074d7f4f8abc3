"""Derivations of the textbook cases: each module yields the records of one collection, with the derivation of each answer."""
