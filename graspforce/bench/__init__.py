"""Benchmark suite: solvers on force problems with proven answers, judged by the certificate alone.

`registry` lists the solvers, and `solvers/` has one adapter each. `race` selects the tasks, and `worker` runs a solver in its
own process. `judge` assigns verdicts, `statistics` aggregates them, `report` and `plots` present them. `library_check` verifies
the expected answers of the problem library.
"""
