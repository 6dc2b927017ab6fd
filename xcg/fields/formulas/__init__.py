"""Definitions of fields: their rows in the registry, and the algebra that computes them from sums."""
