"""Seeded generators of the large collections: one module for each, whose ``cases()`` yields records without solving them.

A record contains ``expected`` if its construction proves the answer. Otherwise ``benchmarks.write_collections`` adds the
answer: an optimum on which two certified solvers agree, or a checked infeasibility proof.
"""
