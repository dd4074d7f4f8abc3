"""One file a solver, one signature: a force problem in, an answer that nobody has checked yet out."""
