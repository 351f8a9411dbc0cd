"""Sessions with a stand-in for a real arm, moved by the files of `loose gap --next` alone."""
