"""Discrete search: graphs of nodes with costs and groups, and moves that keep every constraint."""
