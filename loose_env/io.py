"""Atomic file writing, results as JSON, settings dataclasses checked on creation, sentences.

Formats and settings are dataclasses; pydantic validates them by their annotations. An error is one
line with the place, what was given and what is allowed.
"""

from __future__ import annotations

import ast
import inspect
import json
import math
import os
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    Self,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from annotated_types import Ge, GroupedMetadata, Gt, Lt
from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic_core import CoreConfig, SchemaValidator, core_schema

from loose_env.errors import InvalidData, InvalidSetting

__all__ = [
    "Checked",
    "Count",
    "JsonFile",
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
    "nearest",
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

T = TypeVar("T")


# Files


def written_beside(path: Path, write: Callable[[Path], object]) -> Path:
    """Write a file under another name in its folder, then rename it into place.

    Parameters
    ----------
    path : Path
        The file; its folder is made if it is missing.
    write : callable
        Writes the path it is called with.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        write(beside)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
    return path


def write_bytes(path: Path, data: bytes) -> Path:
    """Write bytes, flushed to the disk before the file is renamed into place."""

    def write(beside: Path) -> None:
        with beside.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())

    return written_beside(path, write)


def write_text(path: Path, text: str) -> Path:
    """Write a text as utf-8, as `write_bytes`.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     write_text(Path(place, "a", "b.txt"), "words").read_text("utf-8")
    'words'
    """
    return write_bytes(path, text.encode("utf-8"))


# Formats


def plain(value: Any, *, digits: int = 7) -> Any:
    """Make values that JSON has, inside mappings and lists too.

    Parameters
    ----------
    value : object
        Mappings, sequences, strings, paths and numbers, those of numpy too.
    digits : int
        What a number is worth. One that is not finite becomes None.

    Examples
    --------
    >>> plain({"x": (1, 2 / 3), "y": float("nan")}, digits=3)
    {'x': [1, 0.667], 'y': None}
    """
    if isinstance(value, Mapping):
        return {str(k): plain(v, digits=digits) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v, digits=digits) for v in value]
    if value is None or isinstance(value, (bool, str, int)):
        return value
    if isinstance(value, Path):
        return str(value)
    number = float(value)
    return float(f"{number:.{digits}g}") if math.isfinite(number) else None


def restored(kind: type[T], value: Any, place: str) -> T:
    """Restore a dataclass, with those inside it, from mappings and lists.

    Keys that the dataclass does not have are left out, since later versions may write more.

    Parameters
    ----------
    kind : type
        The dataclass.
    value : object
        What was read.
    place : str
        Where it stands in the file, as errors say it.

    Raises
    ------
    InvalidData
        If a value is missing or of another kind.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass
    ... class Point:
    ...     x: float
    ...     names: tuple[str, ...] = ()
    >>> restored(Point, {"x": 1, "names": ["a", "b"]}, "point")
    Point(x=1.0, names=('a', 'b'))
    >>> restored(Point, {"names": []}, "point")
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: point: 'x' is missing
    """
    try:
        found: T = _reader(kind).validate_python(value)  # type: ignore[arg-type]
    except ValidationError as error:
        raise InvalidData(_first_error(error, kind, place)) from None
    return found


@cache
def _reader(kind: Any) -> SchemaValidator:
    """Validator of what JSON holds: its types as they are, null for an unknown number."""
    return SchemaValidator(_of_json(TypeAdapter(kind).core_schema))


def _of_json(schema: Any) -> Any:
    """Schema by which lists become tuples, mappings dataclasses, and null not a number."""
    if isinstance(schema, list):
        return [_of_json(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    made = {
        key: value if key in ("default", "expected", "metadata") else _of_json(value)
        for key, value in schema.items()
    }
    if made.get("type") in ("bool", "float", "int", "str"):
        made["strict"] = True
    if made.get("type") == "float":
        return core_schema.no_info_wrap_validator_function(_number, made)
    return made


def _number(value: Any, check: Callable[[Any], float]) -> float:
    """A number; null becomes the one object, so that results compare equal."""
    return math.nan if value is None else check(value)


_NEEDED = {
    "bool_type": "true or false",
    "dataclass_type": "a mapping",
    "dict_type": "a mapping",
    "float_type": "float",
    "int_from_float": "int",
    "int_type": "int",
    "string_type": "str",
    "tuple_type": "a list",
}
"""Kind of an error of pydantic -> what is needed."""


def _first_error(error: ValidationError, kind: Any, place: str) -> str:
    """The first fault of a file in one line: its place, what was given, what is allowed."""
    first = error.errors(include_url=False)[0]
    fault, given, context = first["type"], first["input"], first.get("ctx", {})
    *home, last = first["loc"] or ("",)
    if fault not in ("missing", "unexpected_keyword_argument") and last != "":
        home.append(last)
    separator = " " if place.endswith(":") else "."
    for step in home:
        place += f"[{step}]" if isinstance(step, int) else f"{separator}{step}"
        separator = "."
    place = place.removesuffix(":")
    if fault == "missing":
        return f"{place}: {last!r} is missing"
    if fault == "unexpected_keyword_argument":
        known = _keys(kind, home)
        return f"{place}: unknown key {last!r}; known are {known}{nearest(str(last), known)}"
    if fault in _NEEDED:
        return f"{place}: {_NEEDED[fault]} is needed, not {given!r:.60}"
    if fault == "literal_error":
        return f"{place}: {given!r:.60} is none of {context['expected']}"
    if fault == "too_long" and "actual_length" in context:
        return f"{place}: {context['max_length']} values are needed, not {context['actual_length']}"
    return f"{place}: {context.get('error', first['msg'])}; got {given!r:.60}"


def _keys(kind: Any, path: Sequence[str | int]) -> list[str]:
    """Fields of the dataclass at a path inside another one."""
    for step in path:
        if isinstance(step, str) and is_dataclass(kind):
            kind = get_type_hints(kind)[step]
            if get_origin(kind) in (Union, UnionType):
                kind = next((one for one in get_args(kind) if is_dataclass(one)), kind)
        else:  # an entry of a tuple, a value of a mapping
            kind = [one for one in get_args(kind) if one is not Ellipsis][-1]
    return [each.name for each in fields(kind)]


def nearest(given: str, names: Sequence[str]) -> str:
    """Words that suggest the nearest of some names, or nothing where none is near.

    Examples
    --------
    >>> nearest("Sholder", ["elbow", "shoulder"])
    "; did you mean 'shoulder'?"
    """
    lower = {name.lower(): name for name in reversed(names)}
    found = get_close_matches(given.lower(), lower, n=1)
    return f"; did you mean {lower[found[0]]!r}?" if found else ""


def json_text(whole: Mapping[str, Any], *, digits: int = 7) -> str:
    """Text of a file; numbers that are not finite become null.

    Examples
    --------
    >>> print(json_text({"gap": 2 / 3, "after": float("inf")}, digits=3), end="")
    {
     "gap": 0.667,
     "after": null
    }
    """
    values = plain(whole, digits=digits)
    return json.dumps(values, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def whole_of(text: str, *, format: str, noun: str) -> dict[str, Any]:
    """Read the text of a file of some format.

    Parameters
    ----------
    text : str
        The text.
    format : str
        What its "format" has to be.
    noun : str
        What errors call it.

    Raises
    ------
    InvalidData
        If it is no JSON, or none of the format.
    """
    try:
        whole = json.loads(text, parse_constant=_refused, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        raise InvalidData(f"the {noun} is no JSON: {error}") from None
    if not isinstance(whole, dict) or whole.get("format") != format:
        given = whole.get("format") if isinstance(whole, dict) else whole
        raise InvalidData(f"a {noun} of the format {format!r} is needed, not {given!r:.60}")
    return whole


class JsonFile:
    """A dataclass that is the content of a JSON file, with the key ``format``."""

    noun: ClassVar[str]
    """What errors call it."""

    def to_json(self) -> str:
        """Text of the file; numbers that are not finite become null."""
        content = asdict(self)  # type: ignore[call-overload]
        return json_text({"format": content["format"], **content})

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Read the text of a file.

        Raises
        ------
        InvalidData
            If it is none of the class's format.
        """
        whole = whole_of(text, format=vars(cls)["format"], noun=cls.noun)
        return restored(cls, whole, cls.noun)

    def write(self, path: str | Path) -> Path:
        """Write the file beside its place and rename it."""
        return write_text(Path(path), self.to_json())


def read_result_file(path: str | Path, parse: Callable[[str], T], *, noun: str) -> T:
    """Read a file, or ``result.json`` of a folder; errors begin with the file's name.

    Parameters
    ----------
    path : str or Path
        The file, or the folder.
    parse : callable
        Makes of the text what it stands for.
    noun : str
        What errors call it.

    Raises
    ------
    InvalidData
        If it cannot be read, or ``parse`` refuses it.
    """
    file = Path(path)
    if file.is_dir():
        file = file / "result.json"
    try:
        text = file.read_text("utf-8")
    except FileNotFoundError:
        raise InvalidData(
            f"there is no {noun} {str(file)!r}; give the folder that the command wrote which makes "
            "it (its --out)"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise InvalidData(f"{file}: the {noun} cannot be read: {why}") from None
    try:
        return parse(text)
    except InvalidData as error:
        raise InvalidData(f"{file}: {error}") from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse an object in which a key stands twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [key for key, _ in pairs]
        twice = next(key for key in names if names.count(key) > 1)
        raise ValueError(f"the key {twice!r} stands twice in one object")
    return found


def _refused(word: str) -> float:
    """Refuse the words for numbers that JSON does not have."""
    raise ValueError(f"{word} is no number of JSON; unknown ones are null")


# Settings


@dataclass(frozen=True)
class Rule(GroupedMetadata):
    """Condition on a value, written as metadata of an annotated field."""

    words: str
    """Allowed values, as an error states them."""
    constraints: tuple[Any, ...] = ()
    """What pydantic checks beside the type, such as ``annotated_types.Gt(0)``."""

    def __iter__(self) -> Iterator[Any]:
        return iter(self.constraints)


def is_finite(value: object) -> bool:
    """Return whether a value is one finite real number; truth values are none."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def is_whole(value: object) -> bool:
    """Return whether a value is a whole number; truth values are none."""
    return isinstance(value, Integral) and not isinstance(value, bool)


NonNegative = Annotated[float, Rule("a finite number, zero or more", (Ge(0),))]
"""Number from zero."""
Positive = Annotated[float, Rule("positive and finite", (Gt(0),))]
"""Number above zero."""
Probability = Annotated[float, Rule("a probability between 0 and 1", (Gt(0), Lt(1)))]
"""Number above 0 and below 1."""
Count = Annotated[int, Rule("a whole number, 1 or more", (Ge(1),))]
"""Whole number from 1."""
NonNegativeCount = Annotated[int, Rule("a whole number, 0 or more", (Ge(0),))]
"""Whole number from 0."""


def positive(unit: str) -> Rule:
    """Rule of a number above zero, with its unit."""
    return Rule(f"positive {unit}", (Gt(0),))


def all_of(values: object, allows: Callable[[Any], bool], *, least: int = 0) -> bool:
    """Return whether a value is a sequence of so many entries that a condition allows."""
    return (
        isinstance(values, Sequence)
        and not isinstance(values, str)
        and len(values) >= least
        and all(map(allows, values))
    )


class Checked:
    """Base of settings dataclasses that check their fields when they are made."""

    def __post_init__(self) -> None:
        check_fields(self)


def check_fields(settings: Any, kind: Any = None) -> None:
    """Refuse values that the annotations of a dataclass do not allow; make tuples of lists.

    Numbers, words, one of several words, tuples, dataclasses and optional fields are checked;
    fields of any other type are not. A list, as JSON has it, or an array is the same setting as the
    tuple of its values. With ``kind``, a base class, its fields alone are checked.

    Raises
    ------
    InvalidSetting
        Naming the first such field, the allowed values and the value given.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Own(Checked):
    ...     most: int = 3
    ...     share: NonNegative | None = None
    ...     ends: tuple[float, ...] = ()
    >>> Own(share=1, ends=[0.0, 0.5])
    Own(most=3, share=1, ends=(0.0, 0.5))
    >>> Own(most=2.5)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidSetting: Own.most must be a whole number; got 2.5
    """
    kind = kind or type(settings)
    for name, (validator, words) in _rules(kind):
        if validator is None:
            continue
        value = getattr(settings, name)
        if validator.isinstance_python(value):
            continue
        if not validator.isinstance_python(bare := _bare(value)):
            raise InvalidSetting(f"{kind.__name__}.{name} must be {words}; got {value!r:.200}")
        if isinstance(value, list | np.ndarray):
            object.__setattr__(settings, name, bare)


def unmet(hint: Any, value: Any) -> str:
    """Allowed values where a value is none of them; "" where it is one."""
    validator, words = _validator(hint)
    return "" if validator is None or validator.isinstance_python(_bare(value)) else words


@cache
def _rules(kind: Any) -> tuple[tuple[str, tuple[SchemaValidator | None, str]], ...]:
    """Fields of a dataclass, each with its validator and the words of an error."""
    hints = get_type_hints(kind, include_extras=True)
    return tuple((each.name, _validator(hints[each.name])) for each in fields(kind))


@cache
def _validator(hint: Any) -> tuple[SchemaValidator | None, str]:
    """Validator of a type hint, None where it is not checked, and the words of an error."""
    words = _words(hint)
    if not words:
        return None, ""
    adapter = TypeAdapter(_own_kinds(hint), config=_STRICT)
    return SchemaValidator(adapter.core_schema, CoreConfig(strict=True, allow_inf_nan=False)), words


_STRICT = ConfigDict(strict=True, allow_inf_nan=False, arbitrary_types_allowed=True)
_PLAIN = {float: "a finite number", int: "a whole number", bool: "true or false", str: "text"}


def _words(hint: Any) -> str:
    """Allowed values of a type hint; "" where it is not checked."""
    origin, inside = get_origin(hint), get_args(hint)
    if origin is Annotated:
        own = [one.words for one in inside if isinstance(one, Rule)]
        return own[0] if own else _words(inside[0])
    if origin in (Union, UnionType):
        each = [_words(one) for one in inside if one is not NoneType]
        return " or ".join(each) if all(each) else ""
    if origin is Literal:
        return f"one of {', '.join(map(repr, inside))}"
    if origin is tuple and (each := [_words(inside[0])]) != [""]:
        count = "several" if inside[-1] is Ellipsis else len(inside)
        return f"{count} values, each {each[0]}"
    if is_dataclass(hint):
        return f"a {hint.__name__}"  # type: ignore[union-attr]
    return _PLAIN.get(hint, "")


def _own_kinds(hint: Any) -> Any:
    """Type hint in which dataclasses are checked as instances: they check themselves."""
    origin, inside = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return Union[tuple(map(_own_kinds, inside))]  # noqa: UP007 - made at run time
    if origin is tuple:
        return tuple[tuple(map(_own_kinds, inside))]  # type: ignore[misc]
    return Annotated[Any, _Instance(hint)] if is_dataclass(hint) else hint


@dataclass(frozen=True)
class _Instance:
    kind: Any

    def __get_pydantic_core_schema__(self, *_: Any) -> core_schema.CoreSchema:
        return core_schema.is_instance_schema(self.kind)


def _bare(value: Any) -> Any:
    """A value with tuples for lists and arrays, and Python's numbers for those of numpy."""
    if isinstance(value, list | tuple | np.ndarray):
        return tuple(map(_bare, value))
    return value.item() if isinstance(value, np.generic) else value


# Words


def duration_words(seconds: float) -> str:
    """A duration to two figures, in the unit that suits it.

    Examples
    --------
    >>> [duration_words(s) for s in (0.0123, 1.41, 52.0, 740.0, 13_400.0, 130_000.0)]
    ['12 ms', '1.4 s', '52 s', '12 min', '3.7 h', '36 h']
    """
    for unit, length in (("h", 3600.0), ("min", 60.0), ("s", 1.0)):
        # two minutes in seconds, two hours in minutes: still plain to read
        if seconds >= (1.0 if unit == "s" else 2.0) * length:
            return f"{float(f'{seconds / length:.2g}'):g} {unit}"
    return f"{float(f'{1e3 * seconds:.2g}'):g} ms"


def begun(words: str) -> str:
    """Words as a sentence begins."""
    return words[:1].upper() + words[1:]


def sentence(words: str) -> str:
    """Words as a sentence.

    Examples
    --------
    >>> sentence("the step is coarse"), sentence("Is it?")
    ('The step is coarse.', 'Is it?')
    """
    ended = words.rstrip()
    return begun(ended) + ("" if ended[-1:] in (".", "!", "?", "") else ".")


def field_words(kind: type) -> dict[str, str]:
    """Docstrings under the fields of a dataclass; none where its source is not there.

    Examples
    --------
    >>> field_words(Rule)["words"]
    'Allowed values, as an error states them.'
    """
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(kind)))
    except (OSError, TypeError, SyntaxError):
        return {}
    found: dict[str, str] = {}
    last = ""
    for node in tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else ():
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            last = node.target.id
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and last:
            found[last] = " ".join(str(node.value.value).split())
            last = ""
        else:
            last = ""
    return found
