"""What a field is: its row in the registry, and the algebra that makes it of sums."""
