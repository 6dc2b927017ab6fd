"""Sums over grains and contacts, their smoothing, and the passes over the nodes."""
