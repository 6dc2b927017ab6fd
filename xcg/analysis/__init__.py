"""Analyses beside fields: one file a subject."""
