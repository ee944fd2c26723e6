"""The commands for experts: ``ailsrs expert`` and ``ailsrs demonstrate``."""

from pathlib import Path
from typing import Annotated

from rich.markup import escape
from tyro.conf import Positional, arg

from ailsrs_jax.cli.arguments import (
    EnvName,
    Json,
    OptionalPath,
    PhysicsName,
    Quiet,
    Settings,
    assignments,
)
from ailsrs_jax.cli.console import evaluation_fields, make_console, print_json
from ailsrs_jax.errors import UserError


def demonstrate(
    env: Positional[EnvName],
    output: Annotated[str, arg(metavar="FILE|minari:DATASET_ID")],
    num_trajectories: int = 40,
    expert: OptionalPath = None,
    physics: PhysicsName = "auto",
    seed: int = 0,
    action_noise: float = 0.0,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Roll out an expert and write demonstrations.

    Example: ailsrs demonstrate hopper --num-trajectories 40 --output hopper.npz

    Args:
        env: The task.
        output: The .npz file to write, or minari:DATASET_ID for a new dataset of Minari's.
        num_trajectories: Episodes to roll out, each of at most 1000 steps.
        expert: The expert's policy.npz; without it, the one that ships with the package.
        physics: mjx is pure JAX, mujoco the C engine; auto takes mjx where there is an accelerator.
        seed: Of the initial states, from 0.
        action_noise: Standard deviation of Gaussian noise added to the expert's actions, in their
            units.
    """
    from ailsrs_jax.data.policies import load_policy
    from ailsrs_jax.data.sources import require_target, save_recording
    from ailsrs_jax.envs.registry import resolve_env_id
    from ailsrs_jax.runs import demonstrate
    from ailsrs_jax.runs.policies import load_expert

    env_id = resolve_env_id(env)
    policy = load_policy(expert) if expert else load_expert(env_id)
    if policy.env_id != env_id:
        raise UserError(f"{expert} is an expert of {policy.env_id}, not of {env_id}")
    require_target(output, env_id)
    recording = demonstrate.record(
        policy, num_trajectories, physics=physics, seed=seed, action_noise=action_noise
    )
    save_recording(recording, output)
    returns = recording.demonstrations.returns
    make_console(quiet=quiet, as_json=as_json).print(
        f"{num_trajectories} trajectories of {env_id}, return {returns.mean():.0f} ± "
        f"{returns.std():.0f}, in {escape(output)}",
        soft_wrap=True,
    )
    if as_json:
        print_json(
            {
                "output": output,
                "env_id": env_id,
                "num_trajectories": num_trajectories,
                "return_mean": float(returns.mean()),
                "return_std": float(returns.std()),
                "length_mean": float(recording.demonstrations.lengths.mean()),
            }
        )


def expert(
    env: Positional[EnvName],
    output: Path,
    algorithm: Annotated[str, arg(metavar="ppo|es|ars")] = "ppo",
    settings: Settings = (),
    physics: PhysicsName = "auto",
    seed: int = 0,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Train an expert on the environment's reward.

    Example: ailsrs expert hopper --output hopper_expert.npz

    Args:
        env: The task.
        output: The policy file to write: the best policy met; the last one of es.
        algorithm: Brax's PPO or evolution strategy of a neural policy, or augmented random search
            of a linear one.
        settings: Settings to change, as in --set num_env_steps=1000000; a wrong name lists them
            all.
        physics: mjx is pure JAX, mujoco the C engine; auto takes mjx where there is an accelerator.
        seed: Random seed, from 0.
    """
    from ailsrs_jax.cli.progress import RunProgress
    from ailsrs_jax.envs.registry import resolve_env_id
    from ailsrs_jax.runs.evaluation import evaluate
    from ailsrs_jax.runs.experts.expert import expert_settings, train_expert
    from ailsrs_jax.trainers.parts.settings import parse

    preset = expert_settings(algorithm, resolve_env_id(env))
    changes = parse(preset, assignments(settings))
    console = make_console(quiet=quiet, as_json=as_json)
    with RunProgress(console) as progress:
        policy = train_expert(
            env,
            algorithm=algorithm,
            seed=seed,
            physics=physics,
            output=output,
            watch=progress,
            **changes,
        )
    if quiet and not as_json:
        return
    evaluation = evaluate(policy, physics=physics)
    console.print(
        f"return {evaluation} over 100 episodes, in {escape(str(output))}", soft_wrap=True
    )
    if as_json:
        print_json({"output": str(output), "env_id": policy.env_id} | evaluation_fields(evaluation))
