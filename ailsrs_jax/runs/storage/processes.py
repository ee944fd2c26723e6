"""The processes that share one run, as on a cluster; most runs have only one."""

import contextlib
from collections.abc import Iterator, Sequence

import jax
import numpy as np
from jax.experimental import multihost_utils

from ailsrs_jax.errors import UserError

LISTED = 8  # numbers that the processes tell one another, such as those of checkpoints


def join_processes() -> None:
    """Join the other processes of a SLURM, Open MPI, Kubernetes or Cloud TPU job.

    Raises:
        UserError: there is no such job, or its processes cannot reach one another.
    """
    try:
        jax.distributed.initialize()
    except (ValueError, RuntimeError) as error:
        raise UserError(f"cannot join the processes of a job: {error}") from error


def is_first_process() -> bool:
    """Tell whether this process writes files and prints for all of them."""
    return jax.process_index() == 0


@contextlib.contextmanager
def together(fingerprint: int = 0) -> Iterator[None]:
    """Wait for all processes at the end of the block, and fail in all if one fails.

    Without this the other processes would wait forever for the one that failed. The ``fingerprint``
    of the work to be done must be equal in all of them.

    Raises:
        UserError: the block raised it, the block failed in another process, or fingerprints differ.
    """
    problem: UserError | None = None
    try:
        yield
    except UserError as error:
        problem = error
    mine = np.array([fingerprint, problem is not None])
    prints, failed = multihost_utils.process_allgather(mine).T
    if problem is not None:
        raise problem
    if failed.any():
        raise UserError("another process of this run has failed")
    if len(set(prints.tolist())) > 1:
        raise UserError("the processes have different commands or demonstrations")


def as_the_first_says(numbers: Sequence[int]) -> list[int]:
    """Return the first ``LISTED`` of the first process's ``numbers``, none of them negative."""
    mine = np.full(LISTED, -1)
    mine[: len(numbers)] = numbers[:LISTED]
    first = multihost_utils.broadcast_one_to_all(mine)
    return [int(number) for number in first if number >= 0]


def anywhere(flag: bool) -> bool:
    """Tell whether ``flag`` is set in any process of the run."""
    return bool(multihost_utils.process_allgather(np.array(flag)).any())
