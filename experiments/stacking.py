"""Compare the time of a live environment step of stacked cells with that of one cell, on MJX.

usage: python experiments/stacking.py [ENV] [CELLS ...]    (hopper; 1 4 16)

It trains AILSRS with the tuned preset. The cells differ in seed, number of demonstrations and step
size. Each number of cells is timed over three iterations after the first, all from the same start.
"""

import sys
import time

import jax
import numpy as np

from ailsrs_jax.envs.registry import resolve_env_id
from ailsrs_jax.runs.plan import plan
from ailsrs_jax.runs.spec import RunSpec
from ailsrs_jax.runs.stacking import stack_trainers

ITERATIONS = 3


def main() -> None:
    """Print one line for each number of cells."""
    env_id = resolve_env_id(sys.argv[1] if len(sys.argv) > 1 else "hopper")
    alone = None
    for num_cells in map(int, sys.argv[2:] or (1, 4, 16)):
        speed = steps_per_second(env_id, num_cells)
        alone = alone or speed
        print(
            f"{env_id}, {num_cells} cells: {speed:,.0f} live steps/s, time of a step "
            f"{alone / speed:.3f} of that with the first number",
            flush=True,
        )


def steps_per_second(env_id: str, num_cells: int) -> float:
    """Return the live steps of all cells per second."""
    plans = [
        plan(
            RunSpec(
                env_id,
                num_trajectories=10 * (1 + seed % 4),
                seeds=(seed,),
                settings={"step_size": 0.02 + 0.001 * seed},
                physics="mjx",
            )
        )
        for seed in range(num_cells)
    ]
    make, arguments = stack_trainers([each.make_trainer() for each in plans])
    init = jax.vmap(lambda seed, part: make(part).init(jax.random.key(seed)))
    state = jax.jit(init)(np.arange(num_cells), arguments)
    update = jax.vmap(lambda state, part: make(part).update(state))
    compiled = jax.jit(update).lower(state, arguments).compile()
    state, _ = jax.block_until_ready(compiled(state, arguments))
    num_steps, started = 0, time.perf_counter()
    for _ in range(ITERATIONS):
        state, metrics = compiled(state, arguments)
        num_steps += int(metrics["env_steps"].sum())
    return num_steps / (time.perf_counter() - started)


if __name__ == "__main__":
    main()
