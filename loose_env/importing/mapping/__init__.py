"""Mapping files: which source channel becomes which column, with units.

Data flow: checked_fields -> mapping -> units -> mapping_file.
"""
