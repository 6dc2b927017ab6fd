"""What is summed over grains and contacts, how it is smoothed, and the passes over the nodes that do it."""
