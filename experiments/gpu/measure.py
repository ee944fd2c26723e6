"""Measure on a GPU what docs/gpu.md asks for, each part in a process of its own within its time.

usage: PYTHONPATH=. python experiments/gpu/measure.py [--tiny] [--output gpu.json] [--seconds 470]

The JSON is written again after each part, so that a slow part costs no other part's results. A part
that fails leaves the last line of its error. ``--tiny`` takes sizes that a CPU can simulate.
"""

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

TASKS = ("halfcheetah", "hopper", "walker2d", "ant", "swimmer", "humanoid")
REPEATS = 2


def parts(tiny: bool) -> Iterator[tuple[list[str], int]]:
    """Yield the arguments of each part and its limit in seconds, what matters most first."""
    limit = 300 if tiny else 90  # a CPU takes longer to compile
    speed_batches = (8, 16) if tiny else (1024, 65536, 8192, 32768)
    for index, batch in enumerate(speed_batches):
        for task in TASKS[:1] if tiny or index > 1 else TASKS:
            yield ["speed", task, str(batch)], limit
        if index == 0:
            for task in ("halfcheetah", "hopper"):
                yield ["learn", task], limit
            for count in (1, 2) if tiny else (1, 8, 64):
                yield ["stacked", "halfcheetah", str(count)], limit


def speed(task: str, batch: str, tiny: bool) -> dict[str, Any]:
    """Bare physics, episodes and training with about ``batch`` episodes in an iteration."""
    from ailsrs_jax.runs.benchmark.speed import measure

    measured = measure(task, "mjx", int(batch) // 2, 5 if tiny else 100, REPEATS)
    return dataclasses.asdict(measured)


def run(task: str, tiny: bool, seeds: int, **settings: Any) -> tuple[list[Any], Any]:
    """Train on MJX; return the reports of the iterations, each with the time since the start."""
    import ailsrs_jax as ail

    reports: list[Any] = []
    started = time.perf_counter()
    if tiny:
        settings |= {"num_iterations": 2, "num_directions": 4, "num_top_directions": 2}
        settings |= {"episode_length": 10, "num_evaluation_episodes": 2}
    result = ail.train(
        task,
        num_trajectories=10,
        physics="mjx",
        seeds=tuple(range(seeds)),
        **settings,
        watch=lambda report: reports.append((time.perf_counter() - started, report)),
    )
    return reports, result


def stacked(task: str, count: str, tiny: bool) -> dict[str, Any]:
    """Steps/s of ``count`` seeds as one program, in the second iteration or later."""
    reports, _ = run(task, tiny, int(count), num_iterations=3, num_top_directions=8)
    last = reports[-1][1]
    return {
        "env_steps_per_s": last.env_steps_per_second,
        "compile_s": reports[0][1].compile_seconds,
        "peak_memory_mb": peak_memory_mb(),
    }


def learn(task: str, tiny: bool) -> dict[str, Any]:
    """Seconds from the start of training, compilation included, to 0.9 of the expert's return."""
    reports, result = run(task, tiny, 1)
    target = 0.9 * float(result.expert_returns.mean())
    curve = [(seconds, float(each.metrics["evaluation_return"][0])) for seconds, each in reports]
    reached = [seconds for seconds, value in curve if value >= target]
    return {
        "seconds_to_90": reached[0] if reached else None,
        "target": target,
        "compile_s": reports[0][1].compile_seconds,
        "curve": curve,
    }


def peak_memory_mb() -> float | None:
    """Return the peak of the accelerator's memory; a CPU does not tell."""
    import jax

    statistics = jax.devices()[0].memory_stats() or {}
    return statistics["peak_bytes_in_use"] / 2**20 if statistics else None


def machine() -> dict[str, Any]:
    """Name what measures."""
    import jax

    device = jax.devices()[0]
    return {"device": device.device_kind, "backend": device.platform, "jax": jax.__version__}


def measure_in_process(arguments: list[str], tiny: bool, limit: float) -> dict[str, Any]:
    """Run one part in a process, which is killed at its limit."""
    command = [sys.executable, __file__, "--part", *arguments, *(["--tiny"] if tiny else [])]
    started = time.perf_counter()
    row: dict[str, Any] = {"part": " ".join(arguments)}
    # The GPU's memory is taken as needed, so that its peak is what a part needs.
    environment = os.environ | {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=limit, check=False, env=environment
        )
    except subprocess.TimeoutExpired:
        return row | {"problem": f"not done within {limit:.0f} s"}
    row["wall_s"] = time.perf_counter() - started
    if done.returncode:
        return row | {"problem": (done.stderr.strip().splitlines() or ["no message"])[-1]}
    return row | json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    """Measure all parts, or one."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--tiny", action="store_true")
    parser.add_argument("--output", type=Path, default=Path("gpu.json"))
    parser.add_argument("--seconds", type=float, default=470.0)
    parser.add_argument("--part", nargs="+")
    options = parser.parse_args()
    if options.part:
        name, *arguments = options.part
        functions = {"speed": speed, "stacked": stacked, "learn": learn, "machine": machine}
        keywords = {} if name == "machine" else {"tiny": options.tiny}
        print(json.dumps(functions[name](*arguments, **keywords)))
        return
    end = time.perf_counter() + options.seconds
    rows: list[dict[str, Any]] = []
    for arguments, limit in [(["machine"], 60), *parts(options.tiny)]:
        left = end - time.perf_counter()
        if left < 10:
            rows.append({"part": " ".join(arguments), "problem": "no time was left"})
        else:
            rows.append(measure_in_process(arguments, options.tiny, min(limit, left)))
        options.output.write_text(json.dumps({"tiny": options.tiny, "rows": rows}, indent=1))
        print(rows[-1]["part"], rows[-1].get("problem", "done"), flush=True)


if __name__ == "__main__":
    main()
