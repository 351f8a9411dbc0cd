"""Hyperparameters in rl-zoo format and their command-line overrides."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from loose_env.errors import InvalidSetting, MissingExtra, UnknownName

HYPERPARAMETERS = Path(__file__).parents[1] / "hyperparams"
"""Folder of the hyperparameter files that ship with the agents."""

ALGORITHMS = ("ppo", "maskable_ppo")
"""Names of the algorithms in the rl-zoo."""
_POLICY = "MlpPolicy"

_SCHEDULED = ("learning_rate", "clip_range", "clip_range_vf")
_OF_THE_RUN = ("n_timesteps", "n_envs", "env_kwargs", "normalize")
_GIVEN = ("self", "env", "tensorboard_log", "verbose", "seed", "device", "_init_setup_model")


class LinearSchedule:
    """Linear schedule to zero, over the steps or over what runs out first of a budget."""

    def __init__(self, first: float, budget: Any = None) -> None:
        self.first, self.budget = float(first), budget

    def __call__(self, left: float) -> float:
        """Value at a remaining fraction of the steps."""
        return self.first * (left if self.budget is None else self.budget.left(left))

    def __repr__(self) -> str:
        return f"LinearSchedule({self.first})"


def algorithm_named(name: str) -> type[Any]:
    """Return the algorithm class by its rl-zoo name."""
    if name not in ALGORITHMS:
        raise UnknownName(f"unknown algorithm {name!r}; algorithms are {list(ALGORITHMS)}")
    try:
        if name == "ppo":
            from stable_baselines3 import PPO

            return PPO
        from sb3_contrib import MaskablePPO

        return MaskablePPO
    except ImportError as error:
        raise MissingExtra(
            f"training needs {error.name}; install it with: pip install -e '.[train]'"
        ) from error


def whole(value: Any, name: str) -> int:
    """Read a whole number, which YAML may give as 1e6 or as text."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = -1.0
    if number < 0 or number != round(number):
        raise InvalidSetting(f"{name} must be a whole number, 1 or more; got {value!r}")
    return int(number)


def value_of(text: str) -> Any:
    """Parse a Python literal or ``dict(...)``; words and paths without brackets are strings.

    Nothing is run.
    """
    plain = text.strip()
    try:
        tree = ast.parse(plain, mode="eval").body
        return tree.id if isinstance(tree, ast.Name) else ast.literal_eval(_Literals().visit(tree))
    except (SyntaxError, ValueError, TypeError, RecursionError, MemoryError) as error:
        if (plain[:1].isalpha() or plain[:1] in set("/.~_")) and not set(plain) & set("()[]{}'\""):
            return plain
        raise InvalidSetting(
            f"cannot read {text!r}: a value is a number, a string, a list, a dict or "
            "dict(name=value)"
        ) from error


class _Literals(ast.NodeTransformer):
    """Turns ``dict(name=value)`` and ``nn.Tanh`` into literals, and refuses other code."""

    def visit_Call(self, node: ast.Call) -> ast.Dict:
        self.generic_visit(node)
        names = [word.arg for word in node.keywords]
        if ast.unparse(node.func) != "dict" or node.args or None in names:
            raise ValueError("a call other than dict(name=value)")
        return ast.Dict([ast.Constant(name) for name in names], [w.value for w in node.keywords])

    def visit_Attribute(self, node: ast.Attribute) -> ast.Constant:
        if ast.unparse(node) not in ("nn.Tanh", "nn.ReLU"):
            raise ValueError("an attribute other than nn.Tanh and nn.ReLU")
        from torch import nn

        return ast.Constant(getattr(nn, node.attr))


def key_values(words: Sequence[str], option: str) -> dict[str, Any]:
    """Parse ``key:value`` words in the syntax of rl-zoo's command line."""
    found = {}
    for word in words:
        key, colon, value = word.partition(":")
        if not colon or not key:
            raise InvalidSetting(f"{option} takes key:value, such as n_links:3; got {word!r}")
        try:
            found[key] = value_of(value)
        except InvalidSetting as error:
            raise InvalidSetting(f"{option} {key}: {error}") from error
    return found


def read_hyperparameters(path: str | Path, env_id: str) -> dict[str, Any]:
    """Read an environment's hyperparameters, falling back to "default"."""
    try:
        import yaml  # type: ignore[import-untyped]
    except ImportError as error:
        raise MissingExtra(
            "hyperparameter files need PyYAML; install it with: pip install -e '.[train]'"
        ) from error
    where = Path(path)
    if not where.is_file():
        raise InvalidSetting(f"no hyperparameter file at {where}")
    try:
        found = yaml.safe_load(where.read_text(encoding="utf-8"))
    except (yaml.YAMLError, ValueError, RecursionError, OSError) as error:
        # PyYAML passes on what Python says of a number with too many digits.
        one_line = " ".join(str(error).split())[:300]
        raise InvalidSetting(f"{where} is no YAML file: {one_line}") from error
    if not isinstance(found, dict):
        raise InvalidSetting(f"{where} must have an entry for each environment id")
    own = found.get(env_id, found.get("default"))
    if own is None:
        has = f"{[str(key)[:60] for key in list(found)[:12]]}"
        raise UnknownName(f"{where} has no entry {env_id!r} nor 'default'; it has {has}")
    if not isinstance(own, dict):
        raise InvalidSetting(f"the entry of {env_id!r} in {where} must map names to values")
    return dict(own)


def model_arguments(given: dict[str, Any], algorithm: str) -> dict[str, Any]:
    """Convert hyperparameters to keyword arguments of the algorithm.

    Schedules such as "lin_3e-4" become functions, and policy_kwargs in text becomes a dict.
    What concerns the run and not the model is left out.
    """
    if given.get("normalize"):
        raise InvalidSetting(
            "normalize is not supported: what the policy sees is of the order of one already"
        )
    own = {key: value for key, value in given.items() if key not in _OF_THE_RUN}
    known = [
        name
        for name in inspect.signature(algorithm_named(algorithm).__init__).parameters
        if name not in _GIVEN
    ]
    unknown = sorted(set(own) - set(known))
    if unknown:
        raise UnknownName(
            f"unknown hyperparameters {unknown}; those of {algorithm} are "
            f"{sorted([*known, *_OF_THE_RUN])}"
        )
    if own.setdefault("policy", _POLICY) != _POLICY:
        raise InvalidSetting(f"{algorithm} takes the policy {_POLICY!r}, got {own['policy']!r}")
    for key, value in own.items():
        if isinstance(value, str) and key not in ("policy", "policy_kwargs"):
            # YAML reads 3e-4, without a dot, as text.
            own[key] = _schedule(key, value) if key in _SCHEDULED else _number(key, value)
    kwargs = own.get("policy_kwargs")
    if isinstance(kwargs, str):
        kwargs = own["policy_kwargs"] = value_of(" ".join(kwargs.split()))
    if kwargs is not None and not isinstance(kwargs, dict):
        raise InvalidSetting(f"policy_kwargs must be a dict, got {kwargs!r}")
    if "features_extractor_class" in (kwargs or {}):
        raise InvalidSetting("a policy with its own features extractor cannot be shipped")
    return own


def _schedule(key: str, text: str) -> Any:
    kind, _, first = text.partition("_")
    return LinearSchedule(_number(key, first)) if kind == "lin" else _number(key, text)


def _number(key: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        like = ", or a schedule like lin_3e-4" if key in _SCHEDULED else ""
        raise InvalidSetting(f"{key} is a number{like}; got {text!r}") from None
