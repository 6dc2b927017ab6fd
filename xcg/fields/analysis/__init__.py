"""Analyses of fields: balances, correlations, displacements, stress on walls, choice of a width, pictures."""
