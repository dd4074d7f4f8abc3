"""One file a solver; `graspforce.bench.adapter` says what such a file holds."""
