"""Proof of optimality: cuts, bounds and branching on one part of a problem."""
