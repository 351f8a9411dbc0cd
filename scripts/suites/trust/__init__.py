"""Files, kills and long runs that the package withstands."""
