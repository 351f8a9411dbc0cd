"""Write the JSON Schemas of the file formats, made from the dataclasses that read them.

Usage: python scripts/dev/write_schemas.py. Each file is named after its format.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import core_schema

from loose_env.cli.command import command
from loose_env.gap import GapResult, NextMotion
from loose_env.instrument import Diagnosis, Plan, Trend
from loose_env.io import plain, write_text
from loose_env.recording import Description

FORMATS: dict[str, type[Any]] = {
    "loose-recording/1": Description,
    "loose-gap/1": GapResult,
    "loose-next-motion/1": NextMotion,
    "loose-plan/2": Plan,
    "loose-diagnosis/2": Diagnosis,
    "loose-trend/2": Trend,
}
"""Value of a file's key "format" -> dataclass of its content."""


class FileSchema(GenerateJsonSchema):
    """JSON Schema in which a number that is not known is null."""

    def float_schema(self, schema: core_schema.FloatSchema) -> dict[str, Any]:
        """Schema of a number."""
        return super().float_schema(schema) | {"type": ["number", "null"]}


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the script."""

    out: Path = Path(__file__).parents[2] / "docs" / "schemas"
    """Folder of the schemas."""


def schema(format: str) -> dict[str, Any]:
    """JSON Schema of the files of a format."""
    whole = TypeAdapter(FORMATS[format]).json_schema(schema_generator=FileSchema)
    whole["properties"]["format"] = {"const": format}
    whole["required"] = list(dict.fromkeys(["format", *whole.get("required", ())]))
    found: dict[str, Any] = plain({"$schema": GenerateJsonSchema.schema_dialect, **whole})
    return found


def write(settings: Settings) -> None:
    """Write the schemas."""
    for format in FORMATS:
        file = settings.out / f"{format.replace('/', '-')}.json"
        print(write_text(file, json.dumps(schema(format), indent=1) + "\n"))


if __name__ == "__main__":
    command("write_schemas", __doc__, Settings, write)
