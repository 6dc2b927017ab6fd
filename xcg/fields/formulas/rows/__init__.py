"""Rows of the registry of fields, a module for each topic: what a field is, and the algebra that makes it."""
