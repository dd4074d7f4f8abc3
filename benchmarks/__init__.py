"""How long a certified answer takes. Measure (`timing`), then report (`report`); `python -m benchmarks` does both."""
