"""Recordings of simulations: the truth, measurements and estimates, with metrics and plots."""
