"""Files written beside and renamed, the JSON codec, words for numbers.

Data flow: files -> json_codec -> text.
"""

from loose_env.io.files import (
    write_text,
    written_beside,
)
from loose_env.io.json_codec import (
    json_text,
    plain,
    read_result_file,
    restored,
    whole_of,
)
from loose_env.io.text import (
    begun,
    duration_words,
    sentence,
)

__all__ = [
    "begun",
    "duration_words",
    "json_text",
    "plain",
    "read_result_file",
    "restored",
    "sentence",
    "whole_of",
    "write_text",
    "written_beside",
]
