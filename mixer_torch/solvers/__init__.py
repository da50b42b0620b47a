"""Solvers, one algorithm a file; what MIXER and Exact are made of is in the folders."""
