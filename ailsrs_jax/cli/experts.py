"""The commands for experts: ``ailsrs expert`` and ``ailsrs demonstrate``."""

from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from ailsrs_jax.cli.arguments import Count, EnvName, PhysicsName, Seed, Settings, assignments, maybe
from ailsrs_jax.cli.terminal import TERMINAL, TerminalOptions, evaluation_fields
from ailsrs_jax.errors import UserError
from ailsrs_jax.own_code import is_own


def demonstrate(
    env: Positional[EnvName],
    output: Annotated[str, arg(metavar="FILE|minari:DATASET_ID")],
    num_trajectories: int = 40,
    expert: Annotated[str | None, maybe("POLICY|MODULE:FUNCTION")] = None,
    physics: PhysicsName = "auto",
    seed: Seed = 0,
    episode_length: Count = None,
    action_noise: float = 0.0,
    terminal: TerminalOptions = TERMINAL,
) -> None:
    """Roll out an expert and write demonstrations.

    Example: ailsrs demonstrate hopper --num-trajectories 40 --output hopper.npz

    Args:
        output: The .npz file to write, or minari:DATASET_ID for a new Minari dataset.
        num_trajectories: Episodes to roll out.
        expert: The expert's policy.npz; by default the shipped expert of the task. For gymnasium:ID
            it may be a function of an observation, such as a trained model's.
        episode_length: Steps of an episode; by default those of the run that the expert is in, else
            the environment's time limit.
        action_noise: Standard deviation of Gaussian noise on the actions, in their units.
    """
    from ailsrs_jax.data.policies import load_policy
    from ailsrs_jax.data.sources import require_target, save_recording
    from ailsrs_jax.envs.registry import resolve_env_id
    from ailsrs_jax.runs import demonstrate
    from ailsrs_jax.runs.horizon import policy_horizon
    from ailsrs_jax.runs.policies import load_expert

    env_id = resolve_env_id(env)
    policy: Any = expert
    if expert is None:
        policy = load_expert(env_id)
    elif not is_own(expert):
        policy = load_policy(Path(expert))
        if policy.env_id != env_id:
            raise UserError(f"{expert} is an expert of {policy.env_id}, not of {env_id}")
        if episode_length is None:
            episode_length = policy_horizon(Path(expert))
    require_target(output, env_id)
    recording = demonstrate.record(
        policy,
        num_trajectories,
        env=env_id,
        physics=physics,
        seed=seed,
        episode_length=episode_length,
        action_noise=action_noise,
    )
    save_recording(recording, output)
    returns, lengths = recording.demonstrations.returns, recording.demonstrations.lengths
    mean, std = float(returns.mean()), float(returns.std())
    episodes = "trajectory" if num_trajectories == 1 else "trajectories"
    terminal.line(
        f"{num_trajectories} {episodes} of {env_id}, return {mean:.0f} ± {std:.0f}, in {output}"
    )
    terminal.json(
        {
            "output": output,
            "env_id": env_id,
            "num_trajectories": num_trajectories,
            "return_mean": mean,
            "return_std": std,
            "length_mean": float(lengths.mean()),
        }
    )


def expert(
    env: Positional[EnvName],
    output: Path,
    algorithm: Annotated[str, arg(metavar="ppo|es|ars")] = "ppo",
    settings: Settings = (),
    physics: PhysicsName = "auto",
    seed: Seed = 0,
    terminal: TerminalOptions = TERMINAL,
) -> None:
    """Train an expert on the environment's reward.

    Example: ailsrs expert hopper --output hopper_expert.npz

    Args:
        output: The policy file to write: the best policy found; for es the last one.
        algorithm: Brax's PPO or evolution strategy with a neural policy, or augmented random
            search with a linear one.
    """
    from ailsrs_jax.cli.progress import RunProgress
    from ailsrs_jax.envs.registry import resolve_env_id
    from ailsrs_jax.runs.evaluation import evaluate
    from ailsrs_jax.runs.experts.expert import expert_settings, train_expert
    from ailsrs_jax.trainers.parts.settings import parse

    preset = expert_settings(algorithm, resolve_env_id(env))
    changes = parse(preset, assignments(settings))
    with RunProgress(terminal.console, [seed]) as progress:
        policy = train_expert(
            env,
            algorithm=algorithm,
            seed=seed,
            physics=physics,
            output=output,
            watch=progress,
            **changes,
        )
    if terminal.quiet and not terminal.as_json:
        return
    evaluation = evaluate(policy, physics=physics, episode_length=policy.episode_length)
    terminal.line(f"return {evaluation} over 100 episodes, in {output}")
    terminal.json({"output": str(output), "env_id": policy.env_id} | evaluation_fields(evaluation))
