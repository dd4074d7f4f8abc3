"""Benchmarks of graspforce. `python -m benchmarks` measures the structured kernel; the other modules run by their names."""
