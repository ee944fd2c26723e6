"""A small run in its own process, for tests that kill it.

``python -m tests.runs.toy_run OUTPUT ITERATIONS CHECKPOINT_EVERY ALGORITHM`` resumes if there is a
run in OUTPUT, and handles signals as the command line does.
"""

import sys
from pathlib import Path
from typing import Any

from ailsrs_jax.cli.signals import StopSignals
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.loop import execute
from ailsrs_jax.runs.plan import Plan
from ailsrs_jax.runs.plan import plan as make_plan
from ailsrs_jax.runs.spec import RunSpec
from ailsrs_jax.runs.storage.journal import Result
from tests.point_mass import PointMass, noise

SEARCH = {"num_directions": 4, "num_top_directions": 2, "episode_length": 20}
ADVERSARY = {
    "cycle_iterations": 0,  # no early end
    "discriminator_batch_size": 16,
    "memory_iterations": 3,
    "memory_samples": 80,
    "num_distance_samples": 50,
}
SEEDS = (0, 5)


def plan(num_iterations: int, algorithm: str, **changes: Any) -> Plan:
    demonstrations = noise(2, 1, [20, 20, 20], "PointMass")
    settings = SEARCH | {"num_iterations": num_iterations}
    if algorithm == "ailsrs":
        settings |= ADVERSARY
    spec = RunSpec(
        PointMass(),
        demonstrations if algorithm == "ailsrs" else None,
        algorithm=algorithm,
        seeds=SEEDS,
        settings=settings | changes,
    )
    return make_plan(spec)


def run(plan: Plan, output: Path | None = None, **options: Any) -> Result:
    """Train one run."""
    (result,) = execute([plan], [output], **options)
    assert isinstance(result, Result)
    return result


def main(output: Path, num_iterations: int, checkpoint_every: int, algorithm: str) -> None:
    stop = StopSignals()
    try:
        with stop:
            run(
                plan(num_iterations, algorithm),
                output,
                resume="where begun",
                checkpoint_every=checkpoint_every,
                stop=stop,
            )
    except KeyboardInterrupt:
        assert stop.received is not None
        sys.exit(128 + stop.received)
    except UserError as error:
        sys.exit(f"refused: {error}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), sys.argv[4])
