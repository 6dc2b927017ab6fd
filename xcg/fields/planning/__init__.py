"""From what is asked for to what will be done."""
