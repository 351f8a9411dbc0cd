"""A hash of code that does not change with its comments, its docstrings or its layout."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable
from pathlib import Path

__all__ = ["code_hash"]

_WITH_DOCSTRING = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def code_hash(folders: Iterable[Path], *, without: Iterable[str] = ()) -> str:
    r"""Hash of the Python modules in folders and those below them.

    Parameters
    ----------
    folders : iterable of Path
        Packages.
    without : iterable of str
        Names of files, and of folders below the given ones, that are left out.

    Returns
    -------
    str
        16 hexadecimal digits.

    Examples
    --------
    >>> import tempfile
    >>> def hash_of(text):
    ...     with tempfile.TemporaryDirectory() as folder:
    ...         _ = Path(folder, "a.py").write_text(text)
    ...         return code_hash([Path(folder)])
    >>> hash_of('"Doc."\nx = 1\n') == hash_of("x  =  1  # why\n")
    True
    >>> hash_of("x = 1\n") == hash_of("x = 2\n")
    False
    """
    left_out = set(without)
    digest = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.rglob("*.py")):
            if left_out.intersection(path.relative_to(folder).parts):
                continue
            tree = ast.parse(path.read_text(encoding="utf-8"))
            digest.update(f"{folder.name}/{path.relative_to(folder).as_posix()}\n".encode())
            digest.update(ast.dump(_bare(tree)).encode())
    return digest.hexdigest()[:16]


def _bare(tree: ast.Module) -> ast.Module:
    """Take strings that stand alone out of all bodies: they do nothing."""
    for node in ast.walk(tree):
        if isinstance(node, _WITH_DOCSTRING):
            node.body = [
                line
                for line in node.body
                if not (
                    isinstance(line, ast.Expr)
                    and isinstance(line.value, ast.Constant)
                    and isinstance(line.value.value, str)
                )
            ]
    return tree
