"""Damage of any kind, to bytes and to what JSON holds."""

import csv
import io
import json
import random
from pathlib import Path
from typing import Any

Rng = random.Random


def mutate_bytes(content: bytes, rng: Rng) -> bytes:
    """Flip bits, overwrite, cut off, repeat, leave out, and splice."""
    data = bytearray(content)
    for _ in range(rng.choice([1, 1, 1, 2, 4, 16])):
        if not data:
            break
        at = rng.randrange(len(data))
        length = min(rng.choice([1, 1, 2, 4, 8, 64, 1000]), len(data) - at)
        match rng.randrange(8):
            case 0 | 1:
                data[at] ^= 1 << rng.randrange(8)
            case 2:
                data[at : at + length] = rng.randbytes(length)
            case 3:
                del data[rng.choice([at, -at or len(data)]) :]
            case 4:
                del data[at : at + length]
            case 5:
                data[at:at] = data[at : at + length] * rng.choice([1, 2, 100])
            case 6:
                value = rng.choice([0, 0xFF, 0x7F, 0x80])
                data[at : at + length] = bytes([value]) * length
            case 7:
                other = rng.randrange(len(data))
                data[at : at + length] = data[other : other + length]
    return bytes(data)


def odd_value(rng: Rng, depth: int = 0) -> Any:
    """Something that JSON can hold, and a program may not expect."""
    match rng.randrange(14 if depth < 3 else 11):
        case 0:
            return rng.choice([None, True, False, "", {}, []])
        case 1:
            return rng.choice([0, -1, 1, 2**31, 2**63, 2**64, -(2**63), 10**4000])
        case 2:
            return rng.choice([float("nan"), float("inf"), -float("inf"), 1e308, 5e-324, -0.0])
        case 3:
            return "x" * rng.choice([1, 1000, 100_000])
        case 4:
            return rng.choice(["../../../../etc/passwd", "/etc/passwd", "..", ".", "/", "a\0b"])
        case 5:
            return rng.choice(["\n\n", "\x1b[2J", "\ud800", "é" * 50, "os:abort", "posix:_exit"])
        case 6:
            nested: Any = 0
            for _ in range(rng.choice([10, 500, 900])):
                nested = rng.choice([[nested], {"a": nested}])
            return nested
        case 7 | 8 | 9 | 10:
            return rng.choice([rng.random(), rng.randrange(100), "Hopper-v5", "1e5"])
        case 11:
            return [odd_value(rng, depth + 1) for _ in range(rng.randrange(4))]
        case _:
            return {str(odd_value(rng, 9))[:50]: odd_value(rng, depth + 1) for _ in range(3)}


def mutate_tree(tree: Any, rng: Rng) -> Any:
    """Change, leave out or add something somewhere in what JSON holds."""
    if isinstance(tree, dict) and tree and rng.random() < 0.9:
        tree, key = dict(tree), rng.choice(list(tree))
        match rng.randrange(6):
            case 0:
                del tree[key]
            case 1:
                tree[key] = odd_value(rng)
            case 2:
                tree[str(odd_value(rng, 9))[:100]] = odd_value(rng)
            case _:
                tree[key] = mutate_tree(tree[key], rng)
        return tree
    if isinstance(tree, list) and tree and rng.random() < 0.8:
        tree, index = list(tree), rng.randrange(len(tree))
        tree[index] = mutate_tree(tree[index], rng)
        return tree
    return odd_value(rng)


def mutated_json(tree: Any, rng: Rng) -> bytes:
    for _ in range(rng.choice([1, 1, 2, 5])):
        tree = mutate_tree(tree, rng)
    try:
        text = json.dumps(tree).encode()
    except (RecursionError, ValueError):
        text = b"[" * 100_000
    if rng.random() < 0.02:
        text = rng.choice([b"[" * 10**5, b'{"a":' * 10**5, b"9" * 10**5, b" " * 2**21, b""])
    return mutate_bytes(text, rng) if rng.random() < 0.3 else text


def make_csv(rows: list[list[Any]], path: Path, rng: Rng) -> None:
    rows = [list(row) for row in rows]
    for _ in range(rng.choice([0, 1, 1, 3])):
        at = rng.randrange(len(rows))
        match rng.randrange(5):
            case 0:
                del rows[at]
            case 1:
                rows.insert(at, list(rows[rng.randrange(len(rows))]))
            case 2:
                rows[at] = rows[at][: rng.randrange(4)]
            case _ if rows[at]:
                rows[at][rng.randrange(len(rows[at]))] = str(odd_value(rng, 9))
        if not rows:
            break
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    content = text.getvalue().encode(errors="replace")
    path.write_bytes(mutate_bytes(content, rng) if rng.random() < 0.5 else content)
