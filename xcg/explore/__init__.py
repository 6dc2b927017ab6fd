"""Pictures of scenes and fields with sliders, in a notebook or a browser."""
