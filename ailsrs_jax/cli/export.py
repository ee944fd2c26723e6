"""The command that takes a policy away: ``ailsrs export``."""

from pathlib import Path
from typing import Annotated

from rich.markup import escape
from tyro.conf import Positional, arg

from ailsrs_jax.cli.arguments import Json, Quiet
from ailsrs_jax.cli.console import evaluation_fields, make_console, print_json


def export(
    policy: Positional[Annotated[Path, arg(metavar="DIR|POLICY")]],
    output: Annotated[Path, arg(metavar="FILE|DIRECTORY")],
    episodes: int = 100,
    physics: Annotated[str, arg(metavar="gymnasium|auto|mjx|mujoco")] = "gymnasium",
    seed: int = 0,
    license_id: Annotated[str, arg(name="license", metavar="ID")] = "unknown",
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Write a policy for other programs, or with a model card for other people.

    Example: ailsrs export runs/hopper --output policy.onnx

    Example: ailsrs export runs/hopper --output hopper --license apache-2.0

    Args:
        policy: A policy.npz or .safetensors, or the directory of a run with one seed.
        output: A file that ends in .onnx, .safetensors or .npz; or a new directory, for all three
            and a model card, as the Hugging Face Hub reads it.
        episodes: Episodes for the return in the model card, at most 1000 steps long.
        physics: For these; gymnasium is the real environment with the policy in NumPy.
        seed: Of their initial states, from 0.
        license_id: Of the policy, as the Hub writes it: apache-2.0, mit, cc-by-4.0 and so on.
    """
    from ailsrs_jax.show.export import export

    evaluation = export(
        policy, output, num_episodes=episodes, physics=physics, seed=seed, license_id=license_id
    )
    result = f", return {evaluation} over {episodes} episodes" if evaluation else ""
    console = make_console(quiet=quiet, as_json=as_json)
    console.print(f"{escape(str(policy))} is now in {escape(str(output))}{result}", soft_wrap=True)
    if as_json:
        measured = evaluation_fields(evaluation) if evaluation else {}
        print_json({"policy": str(policy), "output": str(output), **measured})
