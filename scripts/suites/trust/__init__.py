"""What is tried to break the package: malformed files, kills, long runs."""
