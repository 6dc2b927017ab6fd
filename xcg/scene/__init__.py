"""Scenes: their variables, and single steps of them."""
