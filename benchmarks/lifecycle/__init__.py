"""From an empty hand to the release: one module for each section of benchmarks/results/lifecycle.md.

A section has a `TITLE`, a function `run` that continues its file of results, and a function `page` that returns its Markdown.
"""
