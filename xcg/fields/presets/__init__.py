"""Names and variants of fields in other programs."""
