"""On-disk store of completed shards, one file each, for resumable work."""

from __future__ import annotations

import json
import os
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np

from loose_agents.execution.configuration_hash import canonical, configuration_hash, differences
from loose_env.errors import InvalidData, InvalidSetting

__all__ = ["ArrayCodec", "Codec", "RowCodec", "ShardStore", "Span"]

FORMAT = "loose-shards/1"
DESCRIPTION = "configuration.json"


class Span(Protocol):
    """Protocol of a shard as seen by a store."""

    @property
    def start(self) -> int:
        """First episode."""

    @property
    def stop(self) -> int:
        """Episode after the last."""


class Codec(Protocol):
    """Encoder and decoder of a shard's result."""

    suffix: str
    """End of the file's name, with its dot."""

    def write(self, value: Any, file: BinaryIO) -> None:
        """Write a result; raise `InvalidData` if its type is wrong."""

    def read(self, path: Path) -> Any:
        """Read a result; raise `InvalidData` if the file is truncated or corrupt."""


class ArrayCodec:
    """Named numpy arrays in an ``.npz`` file, read without unpickling anything."""

    suffix = ".npz"

    def write(self, value: Any, file: BinaryIO) -> None:
        """Write a mapping of names to arrays, byte-for-byte reproducibly."""
        if not isinstance(value, Mapping):
            raise InvalidData(f"a {type(value).__name__} is no mapping of names to arrays")
        with zipfile.ZipFile(file, "w") as archive:
            for name, given in value.items():
                array = np.asarray(given)
                if not isinstance(name, str) or array.dtype.hasobject:
                    raise InvalidData(
                        f"array {name!r} has dtype {array.dtype}; name it with a string and give "
                        "it numbers, booleans or strings"
                    )
                # A ZipInfo of its own has a fixed date.
                with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, array, allow_pickle=False)

    def read(self, path: Path) -> dict[str, np.ndarray]:
        """Read the arrays; zip checksums detect a corrupt file."""
        try:
            with path.open("rb") as file, zipfile.ZipFile(file) as archive:
                return {
                    name.removesuffix(".npy"): _read_member(archive, name)
                    for name in archive.namelist()
                }
        except (
            EOFError,
            NotImplementedError,  # a broken header asks for an unknown compression
            RuntimeError,  # or for a password
            ValueError,
            struct.error,
            zipfile.BadZipFile,
            zlib.error,
        ) as error:
            raise _broken(path, error) from error


class RowCodec:
    """Rows (a list of JSON-compatible dictionaries) in a ``.json`` file, one per line.

    The rows stand in one JSON document, whose last bracket a file cut short lacks. A float comes
    back as it was; a tuple comes back as a list.
    """

    suffix = ".json"

    def write(self, value: Any, file: BinaryIO) -> None:
        """Write rows."""
        rows = value if isinstance(value, Sequence) else None
        if rows is None or not all(
            isinstance(row, Mapping) and all(isinstance(name, str) for name in row) for row in rows
        ):
            raise InvalidData(
                f"a {type(value).__name__} is no list of dictionaries named with strings"
            )
        try:
            lines = [json.dumps(dict(row), default=_plain_number) for row in rows]
        except (TypeError, ValueError) as error:
            raise InvalidData(f"a row does not fit JSON: {error}") from error
        file.write(('{"rows": [\n' + ",\n".join(lines) + "\n]}\n").encode())

    def read(self, path: Path) -> list[dict[str, Any]]:
        """Read rows."""
        try:
            rows: list[dict[str, Any]] = json.loads(path.read_bytes())["rows"]
        except (ValueError, KeyError, TypeError) as error:
            raise _broken(path, error) from error
        return rows


class ShardStore:
    """Folder of results, one file per shard, all from one configuration.

    A file is named after its shard's episodes, so shards of another size never mix. It is
    written beside its name and renamed: a run that is killed leaves whole files only.

    Parameters
    ----------
    folder : path
        Made if it does not exist.
    configuration : mapping or dataclass
        Everything that the results depend on (seed, settings, versions) and nothing else: not
        the backend, not the number of shards. It is kept in ``configuration.json``.
    codec : Codec
        Kind of the files: `ArrayCodec` or `RowCodec`.

    Raises
    ------
    InvalidSetting
        If the folder holds results of another configuration, or files that are not a store's.
    InvalidData
        If the configuration holds what JSON cannot.

    Examples
    --------
    >>> import tempfile
    >>> from loose_agents.execution.shards import shard_of
    >>> shards = shard_of(4, 2)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = ShardStore(folder, {"seed": 1}, RowCodec())
    ...     store.write(shards[1], [{"episode": 2}, {"episode": 3}])
    ...     [shard.index for shard in store.missing(shards)], store.read(shards[1])
    ([0], [{'episode': 2}, {'episode': 3}])
    """

    def __init__(self, folder: str | os.PathLike[str], configuration: Any, codec: Codec) -> None:
        self.folder = Path(folder)
        self.configuration = canonical(configuration)
        self.hash = configuration_hash(configuration)
        self._codec = codec
        self.folder.mkdir(parents=True, exist_ok=True)
        described = self.folder / DESCRIPTION
        if described.exists():
            self._compare(described)
        elif any(self.folder.glob(f"shard-*{codec.suffix}")):
            raise InvalidSetting(
                f"{self.folder} holds shards and no {DESCRIPTION}: what made them is unknown; "
                "choose another folder or remove them"
            )
        else:
            content = {
                "format": FORMAT,
                "hash": self.hash,
                "configuration": self.configuration,
            }
            text = json.dumps(content, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
            self._put(described, lambda file: file.write(text.encode()))

    def path(self, shard: Span) -> Path:
        """File of a shard, whether it exists or not."""
        return self.folder / f"shard-{shard.start:09d}-{shard.stop:09d}{self._codec.suffix}"

    def missing(self, shards: Sequence[Any]) -> list[Any]:
        """Shards whose file is absent or corrupt; every file is read."""
        return [shard for shard in shards if not self._holds(shard)]

    def write(self, shard: Span, value: Any) -> None:
        """Store the result of a shard.

        Raises
        ------
        InvalidData
            If it is not of the codec's kind; the message names the shard.
        """
        try:
            self._put(self.path(shard), lambda file: self._codec.write(value, file))
        except InvalidData as error:
            raise InvalidData(f"{shard} cannot be stored: {error}") from error

    def read(self, shard: Span) -> Any:
        """Result of a shard.

        Raises
        ------
        InvalidData
            If it is not there or broken.
        """
        path = self.path(shard)
        if not path.exists():
            raise InvalidData(f"{path} does not exist: {shard} has not been run")
        return self._codec.read(path)

    def read_all(self, shards: Sequence[Span]) -> Iterator[Any]:
        """Iterate over the results of the shards in order."""
        return map(self.read, shards)

    def unlike(self, configuration: Any) -> str:
        """Differences between another configuration and this store's; may be empty."""
        if configuration_hash(configuration) == self.hash:
            return ""
        return differences(configuration, self.configuration) or "its hash is another"

    def _holds(self, shard: Span) -> bool:
        path = self.path(shard)
        if not path.exists():
            return False
        try:
            self._codec.read(path)
        except InvalidData:
            return False
        return True

    def _compare(self, described: Path) -> None:
        try:
            before = json.loads(described.read_bytes())["configuration"]
        except (ValueError, KeyError, TypeError) as error:
            raise InvalidSetting(
                f"{described} cannot be read ({error}); choose another folder or remove this one"
            ) from error
        unlike = self.unlike(before)
        if unlike:
            raise InvalidSetting(
                f"{self.folder} holds results of another configuration: {unlike}; choose another "
                "folder, or remove this one to begin anew"
            )

    def _put(self, path: Path, write: Any) -> None:
        # The process number keeps two runs on one folder from writing into one file.
        beside = path.with_name(f"{path.name}.{os.getpid()}.part")
        try:
            with beside.open("wb") as file:
                write(file)
            os.replace(beside, path)
        finally:
            beside.unlink(missing_ok=True)


def _read_member(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    with archive.open(name) as member:
        array: np.ndarray = np.lib.format.read_array(member, allow_pickle=False)
        member.read()  # the checksum is compared at the end of the member
    return array


def _plain_number(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{value!r} is a {type(value).__name__}")


def _broken(path: Path, error: Exception) -> InvalidData:
    return InvalidData(f"{path} is cut short or broken ({error}); remove it and run its shard anew")
