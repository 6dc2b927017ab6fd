"""Jobs from files to files, as configurations describe them."""
