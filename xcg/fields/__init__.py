"""Continuum fields: what is asked, and how it is summed."""
