"""Atomic files, the JSON codec, durations and sentences in words, validation of settings.

Data flow: files -> json_codec -> text -> validation.
"""

from loose_env.io.files import write_bytes, write_text, written_beside
from loose_env.io.json_codec import json_text, plain, read_result_file, restored, whole_of
from loose_env.io.text import begun, duration_words, field_words, sentence
from loose_env.io.validation import (
    Checked,
    Count,
    NonNegative,
    NonNegativeCount,
    Positive,
    Probability,
    Rule,
    all_of,
    check_fields,
    is_finite,
    is_whole,
    positive,
    unmet,
)

__all__ = [
    "Checked",
    "Count",
    "NonNegative",
    "NonNegativeCount",
    "Positive",
    "Probability",
    "Rule",
    "all_of",
    "begun",
    "check_fields",
    "duration_words",
    "field_words",
    "is_finite",
    "is_whole",
    "json_text",
    "plain",
    "positive",
    "read_result_file",
    "restored",
    "sentence",
    "unmet",
    "whole_of",
    "write_bytes",
    "write_text",
    "written_beside",
]
