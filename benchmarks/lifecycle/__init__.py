"""From an empty hand to the release: one module for each section of benchmarks/results/lifecycle.md.

A section has a `TITLE`, and three functions: `add_options` adds its options to a parser, `run` continues its file of results,
and `page` returns its Markdown.
"""
