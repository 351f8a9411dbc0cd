"""Methods that only agents and studies under evaluation use."""
