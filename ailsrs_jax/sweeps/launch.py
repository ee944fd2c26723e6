"""Run a sweep on a Ray cluster."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from ailsrs_jax.errors import UserError, one_line, refusing
from ailsrs_jax.sweeps.cells import Cell

RETRIES = 10  # of a unit whose worker is lost; each resumes from the newest checkpoint


def run_on_ray(
    run_unit: Callable[..., None],
    units: Sequence[tuple[Cell, ...]],
    output: Path,
    episodes: int,
    track: str | None,
) -> Iterator[tuple[tuple[Cell, ...], str | None]]:
    """Run ``units`` on the Ray cluster at ``RAY_ADDRESS``, or on this machine if it is not set.

    ``run_unit`` is called with each unit, ``output``, ``episodes`` and ``track``. A unit gets one
    GPU, or all cores of a node if the cluster has no GPU. All nodes have to see the working
    directory, ``output`` and the files of demonstrations under the same paths.

    Yields:
        Each unit when it has ended, and the reason if it could not be run.

    Raises:
        UserError: Ray is not installed, or the cluster does not answer.
    """
    try:
        import ray
    except ImportError:
        raise UserError("--launcher ray needs pip install 'ailsrs_jax[ray]'") from None
    with refusing("cannot connect to a Ray cluster"):
        ray.init(log_to_driver=False)
    try:
        nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        resources = {"num_cpus": min(node["CPU"] for node in nodes if "CPU" in node)}
        if any("GPU" in node for node in nodes):
            resources = {"num_gpus": 1}
        remote = ray.remote(max_retries=RETRIES, **resources)(run_unit)
        running = {remote.remote(unit, output.absolute(), episodes, track): unit for unit in units}
        while running:
            (ended,), _ = ray.wait(list(running))
            unit, problem = running.pop(ended), None
            try:
                ray.get(ended)
            except ray.exceptions.RayTaskError as error:
                problem = one_line(error.cause)
            except ray.exceptions.RayError as error:
                problem = f"all its workers were lost: {one_line(error)}"
            yield unit, problem
    finally:
        ray.shutdown()
