"""Readers of the source formats.

Data flow: csv_lines -> csv_file -> csv_list -> field_path -> mcap_messages -> mcap_records ->
mcap_file -> uff_file -> sources.
"""
