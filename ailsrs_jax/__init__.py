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

# The public names of each module. They are imported when first used: JAX takes seconds to import,
# and the command line should answer before that.
_NAMES = {
    "data.demonstrations": "Demonstrations load_demonstrations save_demonstrations",
    "data.episodes": "Recording load_imitation load_minari save_minari",
    "data.policies": "SavedLinearPolicy SavedMlpPolicy SavedPolicy load_policy",
    "envs.registry": "make_env",
    "envs.tasks.mujoco_task": "MujocoTask",
    "errors": "UserError",
    "runs.demonstrate": "demonstrate record",
    "runs.evaluation": "Evaluation evaluate",
    "runs.experts.evolution": "EvolutionSettings",
    "runs.experts.expert": "train_expert",
    "runs.experts.ppo": "PpoSettings",
    "runs.policies": "jax_policy load_expert",
    "runs.run": "train",
    "runs.storage.journal": "Result",
    "runs.storage.metrics": "IterationReport",
    "show.export": "export",
    "show.reports.report": "report",
    "show.sweep_report": "report_sweep",
    "show.video": "Animation render",
    "sweeps.merge": "merge_sweeps",
    "sweeps.sweep": "sweep",
    "trainers.ailsrs": "Ailsrs make_ailsrs",
    "trainers.algorithms": "find_algorithm preset_settings",
    "trainers.ars": "Ars ArsSettings make_ars",
    "trainers.behavior_cloning": "BehaviorCloning BehaviorCloningSettings make_behavior_cloning",
    "trainers.gail": "Gail GailSettings make_gail",
    "trainers.parts.ailsrs_settings": "AilsrsSettings",
    "trainers.parts.rollout": "Simulator",
    "trainers.parts.trainer": "Algorithm Trainer",
    "trainers.trpo": "Trpo TrpoSettings make_trpo",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = sorted(_HOMES)


if not TYPE_CHECKING:  # else every name would be known to a type checker

    def __getattr__(name):
        if name not in _HOMES:
            raise AttributeError(f"module 'ailsrs_jax' has no attribute '{name}'")
        return getattr(importlib.import_module(f"ailsrs_jax.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
