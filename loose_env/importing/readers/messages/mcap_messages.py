"""Decoding of messages by the encoding of their channel: ROS 2 (CDR), JSON, protobuf."""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Callable
from typing import Any

from loose_env.errors import InvalidData, MissingExtra

Decoder = Callable[[bytes], Any]

READ_ENCODINGS = ("cdr with ros2msg", "json", "protobuf with protobuf")
"""Encodings of messages, and of their schemas, that are read."""

_ADVICE = {
    "ros1": "convert the bag to ROS 2 first",
    "cdr": "record with a version of ROS 2 that stores 'ros2msg' schemas",
}


def encoding_of(channel: Any, schema: Any) -> str:
    """Words for how a channel's messages are encoded."""
    own = "" if schema is None or not schema.encoding else f" with {schema.encoding}"
    return f"{channel.message_encoding or 'nothing'}{own}"


def decoder_of(channel: Any, schema: Any, place: str) -> Decoder:
    """Find what decodes the messages of a channel."""
    encoding = channel.message_encoding
    own = "" if schema is None else schema.encoding
    if encoding == "json":
        return _json
    if (encoding, own) == ("cdr", "ros2msg"):
        factory = _factory("mcap_ros2.decoder", "ROS 2 messages", "mcap-ros2-support")
    elif (encoding, own) == ("protobuf", "protobuf"):
        factory = _factory("mcap_protobuf.decoder", "protobuf messages", "mcap-protobuf-support")
    else:
        advice = next((f"; {a}" for key, a in _ADVICE.items() if key in encoding), "")
        raise InvalidData(
            f"{place}: its messages are {encoding_of(channel, schema)!r:.80}; read are "
            f"{', '.join(READ_ENCODINGS)}{advice}"
        )
    try:
        with contextlib.redirect_stderr(io.StringIO()):  # the parser of ROS 2 prints, too
            decoder = factory().decoder_for(encoding, schema)
    except RecursionError:
        raise InvalidData(f"{place}: the schema is nested too deeply") from None
    except Exception as error:  # the libraries raise whatever their parsers do
        raise InvalidData(
            f"{place}: the schema {schema.name[:80]!r} cannot be read: {_words(error)}"
        ) from None
    if decoder is None:
        raise InvalidData(f"{place}: the schema {schema.name[:80]!r} cannot be read")
    found: Decoder = decoder
    return found


def _factory(module: str, what: str, package: str) -> Callable[[], Any]:
    from importlib import import_module

    try:
        found: Callable[[], Any] = import_module(module).DecoderFactory
    except ImportError:
        raise MissingExtra(f"{what} need {package}: pip install 'loose-env[import]'") from None
    return found


def _json(data: bytes) -> Any:
    return json.loads(data)


def _words(error: Exception) -> str:
    return " ".join(str(error).split())[:160] or type(error).__name__
