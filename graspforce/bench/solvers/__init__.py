"""Solver adapters, one module each; `graspforce.bench.adapter` defines their interface."""
