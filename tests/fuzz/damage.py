"""Hypothesis strategies that damage bytes, JSON values and tables."""

import csv
import io
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_numpy

# Strategies that are made once; Hypothesis takes longer to make one than to draw from it.
LENGTHS = st.sampled_from((1, 1, 2, 4, 8, 64, 1000, None))  # of a piece; None: as long as the file
SHORT = st.binary(max_size=8)
TYPES = (
    st_numpy.scalar_dtypes()
    | st_numpy.unicode_string_dtypes(max_len=20)
    | st_numpy.byte_string_dtypes(max_len=20)
)
SHAPES = st_numpy.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=3)


@st.composite
def damaged_bytes(draw: st.DrawFn, content: bytes) -> bytes:
    """Flip bits, overwrite, insert, delete, repeat and cut off."""
    data = bytearray(content)
    for _ in range(draw(st.sampled_from((1, 1, 2, 4)))):
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        length = draw(LENGTHS) or len(data)
        piece = data[at : at + length]
        flipped = bytes(byte ^ 1 << draw(st.integers(0, 7)) for byte in piece[:1]) + piece[1:]
        known = [b"", flipped, flipped, bytes(len(piece)), b"\xff" * len(piece), piece * 2]
        known += [bytes(reversed(piece)), piece[:8] * 100]
        which = draw(st.integers(0, len(known)))
        data[at : at + length] = known[which] if which < len(known) else draw(SHORT)
    return bytes(data)


def nested(depth: int) -> Any:
    value: Any = 0
    for level in range(depth):
        value = [value] if level % 2 else {"a": value}
    return value


ODD_VALUES = [
    *(None, True, False, "", {}, [], 0, -1, 2**31, 2**63, 2**64, -(2**63), 10**4000),
    *(float("nan"), float("inf"), -float("inf"), 1e308, 5e-324, -0.0, "1e5", "Hopper-v5"),
    *("x" * 1000, "x" * 100_000, "../../../../etc/passwd", "/etc/passwd", "..", "/", "a\0b"),
    *("\n\n", "\x1b[2J", "\ud800", "é" * 50, "os:abort", "posix:_exit", nested(10), nested(900)),
]
odd_values = st.sampled_from(ODD_VALUES) | st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda values: (
        st.lists(values, max_size=3) | st.dictionaries(st.text(max_size=20), values, max_size=3)
    ),
    max_leaves=4,
)


def as_text(value: Any) -> str:
    try:
        return str(value)[:100_000]
    except RecursionError:
        return "[" * 1000


odd_texts = odd_values.map(as_text)


@st.composite
def changed_tree(draw: st.DrawFn, tree: Any) -> Any:
    """Change, delete or add something somewhere in a JSON value."""
    inside = draw(st.integers(0, 9)) > 0
    if isinstance(tree, dict) and tree and inside:
        tree, key = dict(tree), draw(st.sampled_from(list(tree)))
        match draw(st.integers(0, 5)):
            case 0:
                del tree[key]
            case 1:
                tree[draw(odd_texts)[:100]] = draw(odd_values)
            case _:
                tree[key] = draw(changed_tree(tree[key]))
        return tree
    if isinstance(tree, list) and tree and inside:
        index = draw(st.integers(0, len(tree) - 1))
        return [*tree[:index], draw(changed_tree(tree[index])), *tree[index + 1 :]]
    return draw(odd_values)


HUGE_JSON = [b"[" * 10**5, b'{"a":' * 10**5, b"9" * 10**5, b" " * 2**21, b""]


@st.composite
def changed_json(draw: st.DrawFn, tree: Any) -> bytes:
    """The bytes of a changed JSON value, which are sometimes damaged as well."""
    for _ in range(draw(st.sampled_from((1, 1, 2, 5)))):
        tree = draw(changed_tree(tree))
    try:
        content = json.dumps(tree).encode()
    except (RecursionError, ValueError):
        content = HUGE_JSON[0]
    match draw(st.integers(0, 19)):
        case 0:
            return draw(st.sampled_from(HUGE_JSON))
        case 1 | 2 | 3 | 4:
            return draw(damaged_bytes(content))
        case _:
            return content


@st.composite
def changed_csv(draw: st.DrawFn, rows: list[list[Any]]) -> bytes:
    """The bytes of a table with odd cells and with missing, repeated and short rows."""
    rows = [list(row) for row in rows]
    for _ in range(draw(st.sampled_from((0, 1, 1, 3)))):
        at = draw(st.integers(0, len(rows) - 1))
        match draw(st.integers(0, 4)):
            case 0 if len(rows) > 1:
                del rows[at]
            case 1:
                rows.insert(at, list(draw(st.sampled_from(rows))))
            case 2:
                rows[at] = rows[at][: draw(st.integers(0, 3))]
            case _ if rows[at]:
                rows[at][draw(st.integers(0, len(rows[at]) - 1))] = draw(odd_texts)
    content = csv_bytes(rows)
    return draw(damaged_bytes(content)) if draw(st.booleans()) else content


def write_damaged(draw: st.DrawFn, directory: Path, files: Mapping[str, Any]) -> None:
    """Write JSON values and tables, some of them damaged, to the files that are their keys."""
    damaged = draw(st.lists(st.sampled_from(sorted(files)), min_size=1, max_size=2))
    for name, value in files.items():
        path = directory / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if name.endswith(".json"):
            content = draw(changed_json(value)) if name in damaged else json.dumps(value).encode()
        else:
            content = draw(changed_csv(value)) if name in damaged else csv_bytes(value)
        path.write_bytes(content)


def csv_bytes(rows: Iterable[Iterable[Any]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode(errors="replace")


@st.composite
def changed_array(draw: st.DrawFn, array: np.ndarray) -> np.ndarray:
    """An array of another type, shape or value."""
    if array.dtype.kind in "fi" and draw(st.booleans()):
        array = array.copy()
        value = draw(st.sampled_from((np.nan, np.inf, -np.inf, 1e38, 1e-45, 0, -1, 2**62)))
        with np.errstate(all="ignore"):
            array.reshape(-1)[: draw(st.sampled_from((1, 10**9)))] = np.array(value).astype(
                array.dtype
            )
        return array
    shapes = (array.shape, (0, *array.shape[1:]), (1, *array.shape))
    shape = draw(st.sampled_from(shapes)) if draw(st.booleans()) else draw(SHAPES)
    return draw(st_numpy.arrays(draw(TYPES), shape))
