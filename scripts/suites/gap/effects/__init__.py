"""Effects hidden in the recordings, and their catalogue."""
