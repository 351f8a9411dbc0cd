"""Agents that see what their estimator was not made for say that they are unsure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from agents.base import Problem
from agents.belief_agent import AfterOne, BeliefAgent, surprise_of  # noqa: F401
