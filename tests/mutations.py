"""Damage to files, from explicit seeds: other bytes, and members of JSON that become others."""

import copy
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

HOSTILE = (
    None, True, False, 0, -1, 1.5, 1e300, -1e300, 10**20, 10**400, "", "inf", "nan", "-inf", "1",
    "</script><script>alert(1)</script>", "a" * 5000, "\ud800", "../../x", [], {}, [[]], [1, 2, 3],
    {"a": 1},
)  # fmt: skip


CASES = Path(__file__).parents[1] / "../shared/cases/damaged"


def each_case(pattern: str) -> pytest.MarkDecorator:
    """Runs a test for the `path` of every file that was seen to break; skips it without them."""
    skip = pytest.mark.skip(reason="the cases are not in the project")
    paths = sorted(CASES.glob(pattern)) or [pytest.param(CASES / "none", marks=skip)]
    return pytest.mark.parametrize("path", paths, ids=[getattr(p, "stem", "none") for p in paths])


def damaged(content: bytes, seed: int) -> bytes:
    """A file with one to three kinds of damage; half of the JSON is damaged as JSON."""
    rng = np.random.default_rng(seed)
    try:
        tree = json.loads(content)
    except ValueError:
        tree = None
    if tree is None or rng.random() < 0.2:
        return _bytes(content, rng)
    for _ in range(rng.integers(1, 3)):
        _change(tree, rng)
    return json.dumps(tree).encode()


def _bytes(content: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(content)
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(0, max(len(changed), 1)))
        match rng.integers(0, 4):
            case 0:
                del changed[at:]
            case 1:
                changed[at : at + 1] = bytes([rng.integers(0, 256)])
            case 2:
                del changed[at : at + int(rng.integers(1, 30))]
            case 3:
                changed[at:at] = bytes(rng.integers(0, 256, rng.integers(1, 9), np.uint8))
    return bytes(changed)


def _change(tree: Any, rng: np.random.Generator) -> None:
    """Changes one member; members near the root are as likely as all that lie below them."""
    holder = tree
    while True:
        keys = [*(holder if isinstance(holder, dict) else range(len(holder)))]
        key = keys[rng.integers(0, len(keys))]
        child = holder[key]
        if not (isinstance(child, dict | list) and child) or rng.random() < 0.3:
            break
        holder = child
    match rng.integers(0, 5):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, list):
            holder.insert(key, copy.deepcopy(child))
        case 2:
            others = [*_members(tree)]
            holder[key] = copy.deepcopy(others[rng.integers(0, len(others))])
        case 3 if isinstance(child, int | float) and abs(child) <= sys.float_info.max:
            holder[key] = float(child) * float(rng.choice([-1, 0, 1e-30, 1e30, 1 + 1e-9]))
        case 4 if isinstance(holder, dict):
            holder[f"{key}</script><img src=x onerror=alert(1)>"] = holder.pop(key)
        case _:
            holder[key] = HOSTILE[rng.integers(0, len(HOSTILE))]


def _members(tree: Any) -> Iterator[Any]:
    for child in tree.values() if isinstance(tree, dict) else tree:
        yield child
        if isinstance(child, dict | list) and len(child) < 100:
            yield from _members(child)
