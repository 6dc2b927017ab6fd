"""What a scene is, and what one step of it holds."""
