"""Choice of the next record, and searches with a rule of their own."""
