"""One file a solver; `graspforce.bench.entrant` says what such a file holds."""
