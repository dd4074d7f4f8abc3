"""The solver suite: solvers raced on force problems with known answers, each answer judged by the certificate alone.

`registry` names the solvers, `solvers/` has one file for each; `worker` runs one in a process of its own, `race` drives the
workers, `judge` says what an answer is worth, `statistics` sums up, `figures` and `page` show it.
"""
