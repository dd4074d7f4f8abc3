"""The large collections, seeded: one file a collection, each with ``cases()``, which yields records without solving anything.

Where an answer follows from the construction the record has its ``expected``; elsewhere whoever runs the generators adds what
two solvers and the certificate agree on, for no solver is known here.
"""
