"""Sweeps on a Ray cluster."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from ailsrs_jax.errors import UserError, one_line
from ailsrs_jax.sweeps.cells import Cell

RETRIES = 10  # of a unit whose worker is lost; each goes on from its newest checkpoint


def run_on_ray(
    run_unit: Callable[..., None],
    units: Sequence[tuple[Cell, ...]],
    output: Path,
    episodes: int,
    track: str | None,
) -> Iterator[tuple[tuple[Cell, ...], str | None]]:
    """Run ``units`` on the cluster that ``RAY_ADDRESS`` names, or on this machine alone.

    A unit gets a GPU or, where the cluster has none, all cores of a node. All nodes have to see
    ``output``, and the working directory with what the cells name, under the same paths.

    Args:
        run_unit: what trains a unit, given the unit, ``output``, ``episodes`` and ``track``.
        units: cells that are trained together.
        output: the directory of the sweep.
        episodes: of each kept policy.
        track: where else the metrics go.

    Yields:
        Each unit as it ends, and why it could not be run, if so.

    Raises:
        UserError: Ray is not installed, or the cluster does not answer.
    """
    try:
        import ray
    except ImportError:
        raise UserError("--launcher ray needs pip install 'ailsrs_jax[ray]'") from None
    try:
        ray.init(log_to_driver=False)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise UserError(f"no Ray cluster: {one_line(error)}") from error
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
                problem = f"no worker survived it: {one_line(error)}"
            yield unit, problem
    finally:
        ray.shutdown()
