"""Readers of the source formats.

Data flow: rtde_names -> csv_lines -> csv_file -> csv_list -> messages -> uff_file -> datasets ->
sources.
"""
