"""Packings: contacts from positions, and their microstructure."""
