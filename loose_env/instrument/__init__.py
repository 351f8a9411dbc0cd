"""The instrument: from a recording of a suspect arm to the loose link, and to the next pose."""
