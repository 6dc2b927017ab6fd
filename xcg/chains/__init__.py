"""Force chains: regions, search, selection, tracks over time, tables, pictures."""
