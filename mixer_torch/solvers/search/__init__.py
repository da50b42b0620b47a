"""Discrete search: graphs of nodes with costs and tokens, and moves that keep every constraint."""
