"""Adversarial imitation learning via random search, in JAX."""

import importlib
import os

from ailsrs_jax.versions import avoid_deadlock

TYPE_CHECKING = False  # as type checkers know it; the module typing takes time to import

if TYPE_CHECKING:
    from ailsrs_jax.data.demonstrations import Demonstrations as Demonstrations
    from ailsrs_jax.data.demonstrations import load_demonstrations as load_demonstrations
    from ailsrs_jax.data.demonstrations import save_demonstrations as save_demonstrations
    from ailsrs_jax.data.episodes import Recording as Recording
    from ailsrs_jax.data.episodes import load_imitation as load_imitation
    from ailsrs_jax.data.episodes import load_minari as load_minari
    from ailsrs_jax.data.episodes import save_minari as save_minari
    from ailsrs_jax.data.policies import SavedLinearPolicy as SavedLinearPolicy
    from ailsrs_jax.data.policies import SavedMlpPolicy as SavedMlpPolicy
    from ailsrs_jax.data.policies import SavedPolicy as SavedPolicy
    from ailsrs_jax.data.policies import load_policy as load_policy
    from ailsrs_jax.envs.registry import make_env as make_env
    from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask as MujocoTask
    from ailsrs_jax.errors import UserError as UserError
    from ailsrs_jax.runs.demonstrate import demonstrate as demonstrate
    from ailsrs_jax.runs.demonstrate import record as record
    from ailsrs_jax.runs.evaluation import Evaluation as Evaluation
    from ailsrs_jax.runs.evaluation import evaluate as evaluate
    from ailsrs_jax.runs.experts.evolution import EvolutionSettings as EvolutionSettings
    from ailsrs_jax.runs.experts.expert import train_expert as train_expert
    from ailsrs_jax.runs.experts.ppo import PpoSettings as PpoSettings
    from ailsrs_jax.runs.policies import jax_policy as jax_policy
    from ailsrs_jax.runs.policies import load_expert as load_expert
    from ailsrs_jax.runs.run import train as train
    from ailsrs_jax.runs.storage.journal import Result as Result
    from ailsrs_jax.runs.storage.metrics import IterationReport as IterationReport
    from ailsrs_jax.show.export import export as export
    from ailsrs_jax.show.reports.report import report as report
    from ailsrs_jax.show.sweep_report import report_sweep as report_sweep
    from ailsrs_jax.show.video import Animation as Animation
    from ailsrs_jax.show.video import render as render
    from ailsrs_jax.sweeps.merge import merge_sweeps as merge_sweeps
    from ailsrs_jax.sweeps.sweep import sweep as sweep
    from ailsrs_jax.trainers.ailsrs import Ailsrs as Ailsrs
    from ailsrs_jax.trainers.ailsrs import make_ailsrs as make_ailsrs
    from ailsrs_jax.trainers.algorithms import find_algorithm as find_algorithm
    from ailsrs_jax.trainers.algorithms import preset_settings as preset_settings
    from ailsrs_jax.trainers.ars import Ars as Ars
    from ailsrs_jax.trainers.ars import ArsSettings as ArsSettings
    from ailsrs_jax.trainers.ars import make_ars as make_ars
    from ailsrs_jax.trainers.behavior_cloning import BehaviorCloning as BehaviorCloning
    from ailsrs_jax.trainers.behavior_cloning import (
        BehaviorCloningSettings as BehaviorCloningSettings,
    )
    from ailsrs_jax.trainers.behavior_cloning import make_behavior_cloning as make_behavior_cloning
    from ailsrs_jax.trainers.gail import Gail as Gail
    from ailsrs_jax.trainers.gail import GailSettings as GailSettings
    from ailsrs_jax.trainers.gail import make_gail as make_gail
    from ailsrs_jax.trainers.parts.ailsrs_settings import AilsrsSettings as AilsrsSettings
    from ailsrs_jax.trainers.parts.rollout import Simulator as Simulator
    from ailsrs_jax.trainers.parts.trainer import Algorithm as Algorithm
    from ailsrs_jax.trainers.parts.trainer import Trainer as Trainer
    from ailsrs_jax.trainers.trpo import Trpo as Trpo
    from ailsrs_jax.trainers.trpo import TrpoSettings as TrpoSettings
    from ailsrs_jax.trainers.trpo import make_trpo as make_trpo

# XLA, as it takes a program from the cache, prints lines about processor features that only tell
# the compiler what to prefer. It reads this as JAX is imported; errors are raised all the same.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
avoid_deadlock()

# Where each public name lives. They are imported when first used: JAX takes seconds to import, and
# the command line should answer before that.
_HOMES = {
    "Ailsrs": "trainers.ailsrs",
    "AilsrsSettings": "trainers.parts.ailsrs_settings",
    "Algorithm": "trainers.parts.trainer",
    "Animation": "show.video",
    "Ars": "trainers.ars",
    "ArsSettings": "trainers.ars",
    "BehaviorCloning": "trainers.behavior_cloning",
    "BehaviorCloningSettings": "trainers.behavior_cloning",
    "Demonstrations": "data.demonstrations",
    "Evaluation": "runs.evaluation",
    "EvolutionSettings": "runs.experts.evolution",
    "Gail": "trainers.gail",
    "GailSettings": "trainers.gail",
    "IterationReport": "runs.storage.metrics",
    "MujocoTask": "envs.tasks.mujoco_task",
    "PpoSettings": "runs.experts.ppo",
    "Recording": "data.episodes",
    "Result": "runs.storage.journal",
    "SavedLinearPolicy": "data.policies",
    "SavedMlpPolicy": "data.policies",
    "SavedPolicy": "data.policies",
    "Simulator": "trainers.parts.rollout",
    "Trainer": "trainers.parts.trainer",
    "Trpo": "trainers.trpo",
    "TrpoSettings": "trainers.trpo",
    "UserError": "errors",
    "demonstrate": "runs.demonstrate",
    "evaluate": "runs.evaluation",
    "export": "show.export",
    "jax_policy": "runs.policies",
    "load_demonstrations": "data.demonstrations",
    "load_expert": "runs.policies",
    "load_imitation": "data.episodes",
    "load_minari": "data.episodes",
    "load_policy": "data.policies",
    "make_ailsrs": "trainers.ailsrs",
    "make_ars": "trainers.ars",
    "make_behavior_cloning": "trainers.behavior_cloning",
    "make_env": "envs.registry",
    "make_gail": "trainers.gail",
    "make_trpo": "trainers.trpo",
    "merge_sweeps": "sweeps.merge",
    "find_algorithm": "trainers.algorithms",
    "preset_settings": "trainers.algorithms",
    "record": "runs.demonstrate",
    "render": "show.video",
    "report": "show.reports.report",
    "report_sweep": "show.sweep_report",
    "save_demonstrations": "data.demonstrations",
    "save_minari": "data.episodes",
    "sweep": "sweeps.sweep",
    "train": "runs.run",
    "train_expert": "runs.experts.expert",
}

__all__ = sorted(_HOMES)


if not TYPE_CHECKING:  # else every name would be known to a type checker

    def __getattr__(name):
        if name not in _HOMES:
            raise AttributeError(f"module 'ailsrs_jax' has no attribute '{name}'")
        return getattr(importlib.import_module(f"ailsrs_jax.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
