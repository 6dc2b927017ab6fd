"""Force chains: regions, search, selection, tables, tracks over time, pictures."""
