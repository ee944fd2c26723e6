"""Write RESULTS.md: every claim of the paper, compared with the committed results of our sweeps.

usage: python -m experiments.results                             make figures, tables, page again
       python -m experiments.results add NAME DIRECTORY COMMIT    first add the results of a sweep

``ailsrs sweep experiments/NAME.toml`` writes tables to DIRECTORY. ``add`` copies them to
experiments/results/NAME and adds COMMIT, at which the sweep ran, to the commits in provenance.json.
If no cells of earlier commits are left, delete provenance.json first.
"""

import json
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ailsrs_jax.errors import UserError
from ailsrs_jax.files import write_atomically, write_json
from ailsrs_jax.show.sweep_report import (
    aggregate_tables,
    markdown_section,
    markdown_table,
    report_sweep,
)
from ailsrs_jax.sweeps.cells import load_sweep
from ailsrs_jax.sweeps.results import COLUMNS, SweepResults, read_results
from ailsrs_jax.sweeps.statistics import group_cells
from ailsrs_jax.sweeps.sweep import SWEEP_FILE
from experiments import published, readings, robustness, two_readings
from experiments.claims import CLAIMS, UNTESTED
from experiments.evidence import (
    FIGURE_2,
    FIGURE_2_LINEAR,
    MOST,
    PAPER_EXPERTS,
    Evidence,
    NotRunError,
    judge,
)
from experiments.rules import short
from experiments.two_readings import summary

EXPERIMENTS = Path(__file__).parent
RESULTS = EXPERIMENTS / "results"
PAGE = EXPERIMENTS / "RESULTS.md"
# Those shown on the page; the folder has more.
FIGURES = ("figure_2", "figure_3_ailsrs", "scores", "profiles")

INTRODUCTION = """\
# The paper's claims, and our results

This page compares each claim of *Adversarial Imitation Learning via Random Search* (Shin and Kim,
IJCNN 2019) with our results. `python -m experiments.results` writes it from the tables in
`experiments/results/`; do not edit it by hand.

**Rules.** Each claim has a rule, which is code in `experiments/rules.py`. A rule consists of
comparisons. If all of them hold, the claim is *reproduced*; if at least half hold, *partly*; if
fewer hold, *not*. ✗ marks a comparison that does not hold. A claim is *not yet run* while one of
its seeds is missing.

**Numbers.** Returns are those of the kept policies in Gymnasium's own environments. A normalised
return is 0 for random actions and 1 for the expert. Algorithms that imitate choose the policy
without the reward; ARS and TRPO choose it by the reward. ± is the standard deviation over seeds.
With three seeds it is a rough figure. The paper does not say what its own ± is.

**What differs from the paper**

- *AILSRS's settings* are those of the [tuned preset](../docs/algorithms.md#presets-of-ailsrs), not
  those of Table I. There are 16 directions instead of 320, and 32 on HalfCheetah. Every task starts
  from a clone with an intercept. Observations are in units of the expert's standard deviation.
  There is a gradient penalty and a memory of past policies, and the policy is the mean of the last
  iterates. On Hopper, Walker2d and Swimmer, half of an episode's score is its energy distance to
  the demonstrations, and an early fall costs something; GAIL has no such cost. On HalfCheetah,
  perturbed policies run for 200 steps, half of them from demonstrated states, which needs a
  simulator that can be put into a state. A run that is not close to the expert gets up to two more
  cycles. One claim is judged by Table I itself ([table_1](#table_1)). On Humanoid
  ([ant_humanoid](#ant_humanoid)) the claims are judged by linear policies with the settings of any
  task, because the preset's policy is a network there.
- *Tuning.* The settings were chosen on other seeds, from 100 on, but with demonstrations of the
  same forty. Hopper's cycles, and Swimmer's cycles and `keep_within`, were chosen after seeds 0 to
  9 had been seen, so AILSRS has seeds from 10 on there.
- *Demonstrations.* In [paper](#paper), [paper_linear](#paper_linear) and [curves](#curves) all
  seeds have the same demonstrations, the first ones of forty. So their intervals leave out what
  other demonstrations would change. In [search](#search), [ant_humanoid](#ant_humanoid) and the
  tables of little data, each seed draws its own.
- *GAIL's settings* were not tuned for each task. As in the paper, GAIL starts from behaviour
  cloning on HalfCheetah, where its clone is at the expert's level, and from nothing on the other
  three tasks. On Ant and Humanoid it starts from its clone; the paper makes no such comparison.
  Each task has its own number of iterations. GAIL has 1.2 M steps on HalfCheetah and 1.5 to 1.7 M
  on the other tasks, and might need more. It chooses its policy by 4 evaluation episodes, and by 8
  on Walker2d. AILSRS chooses by 8, and by 12 on HalfCheetah. So the tables compare two set-ups, not
  the two methods at their best.
- *Tasks and experts.* The tasks are version 5, not 2, and the experts are others. So returns are
  compared as shares of the expert's return.
- *Walker2d.* The expert of the paper's level falls after about 385 steps. A policy that stands
  still for all 1000 steps returns as much, and one that walks on returns twice as much. So on
  Walker2d, a return near the expert's does not show that a policy walks like it. The same is true
  of the time to reach it.
- *Behaviour cloning.* `BC` trains the paper's linear policy, which has no intercept. It fails here
  on HalfCheetah, Hopper and Walker2d. So another algorithm is easily better than BC here, and a
  failed clone varies little. `neural BC` trains a policy of GAIL's structure, and no claim depends
  on it.
- *Figure 3.* We read the paper's "1, 3 and 5 random seeds" as the number of runs in a mean curve.

[docs/figures.md](../docs/figures.md) explains the figures.

**Processors.** The cells come from more than one processor, and the same command [ends
differently](../docs/numerics.md#what-is-reproducible) on another one. All AILSRS cells of Figures 2
and 3 come from one, and Figure 2 with linear experts comes from a newer one. [table_1](#table_1)
and [baselines](#baselines) are older than the rest: on HalfCheetah, Table I imitates an earlier
recording of the expert, with a return of 4537."""

CHANGED_WORLDS = f"""\
Normalised returns of policies in worlds in which they were not trained, as means over seeds and
{robustness.NUM_EPISODES} episodes. The policies of AILSRS are linear, of earlier runs of the first
seeds of [search](#search), and the expert is the neural network that they imitate. The last two
columns are the numbers that a policy consists of, and the time of one action, while the machine did
other things, too. `python -m experiments.robustness DIRECTORY` measures them; Ant was left out."""

CLONES = f"""\
Shares of the expert's return of the paper's linear policy after behaviour cloning, as means over
{readings.NUM_SEEDS} seeds and {readings.NUM_EPISODES} episodes. A column is a task and a number of
demonstrations for which the paper gives a return; shares within 0.1 of the paper's are bold.
The paper does not say whether its experts were linear, whether its demonstrations hold the actions
before or after clipping, or how long Adam went on. None of these readings gives the paper's figures
from thirty or forty demonstrations on HalfCheetah, Hopper and Walker2d, and under none does a clone
improve as much with more data. From ten, no reading comes near on HalfCheetah, Hopper and Swimmer
at once. Walker2d's linear expert stands still.
`python -m experiments.readings` makes the clones."""


def main() -> None:
    """Run the command."""
    try:
        match sys.argv[1:]:
            case []:
                pass
            case ["add", name, directory, commit]:
                add(name, Path(directory), commit)
            case _:
                raise UserError("usage: python -m experiments.results [add NAME DIRECTORY COMMIT]")
        sweeps = read_all(RESULTS)
        for name in sweeps:
            # Figures of labels that no longer exist would stay and be shown.
            shutil.rmtree(RESULTS / name / "figures", ignore_errors=True)
            report_sweep(RESULTS / name)
        write_atomically(PAGE, page(sweeps))
    except UserError as error:
        print(error, file=sys.stderr)
        sys.exit(2)


def add(name: str, source: Path, commit: str, target: Path = RESULTS) -> None:
    """Copy the tables of a sweep to ``target`` and note their origin.

    Raises:
        UserError: the sweep cannot be read, or the commit has no experiments/NAME.toml.
    """
    read_results(source)
    spec = f"experiments/{name}.toml"
    full = _git("rev-parse", "--verify", "--quiet", f"{commit}^{{commit}}")
    if not full or _git("cat-file", "-t", f"{full}:{spec}") != "blob":
        raise UserError(f"{commit} is no commit here that has {spec}")
    directory = target / name
    path = directory / "provenance.json"
    earlier = _provenance(path)["commits"]
    directory.mkdir(parents=True, exist_ok=True)
    for table in COLUMNS:
        shutil.copyfile(source / table, directory / table)
    planned = len(load_sweep(source / SWEEP_FILE).cells)
    commits = [commit for commit in earlier if commit != full] + [full]
    note = {"command": f"ailsrs sweep {spec}", "commits": commits, "cells": planned}
    write_json(path, note)


def read_all(directory: Path) -> dict[str, SweepResults]:
    """Return the results in ``directory`` by the name of their sweep."""
    found = sorted(path.parent for path in directory.glob("*/results.csv"))
    return {path.name: read_results(path) for path in found}


def page(sweeps: Mapping[str, SweepResults], directory: Path = RESULTS) -> str:
    """Return the text of RESULTS.md for the results in ``directory``."""
    evidence = Evidence(sweeps)
    linear = Evidence({FIGURE_2: sweeps[FIGURE_2_LINEAR]} if FIGURE_2_LINEAR in sweeps else {})
    counts: Counter[str] = Counter()
    sections = []
    for section, claims in CLAIMS.items():
        rows = []
        for claim in claims:
            ours, verdict = judge(claim, evidence)
            counts[verdict] += 1
            sweep = f"[{claim.sweep}](#{claim.sweep})" if claim.sweep in sweeps else claim.sweep
            paper = claim.paper or "no figure"
            rows.append([claim.text, paper, ours, claim.rule, sweep, f"**{verdict}**"])
        header = ["claim", "paper", "ours", "rule", "sweep", "verdict"]
        sections += [f"## {section}", markdown_table(header, rows)]
    parts = [
        INTRODUCTION,
        f"**{counts.total()} claims: {summary(counts)}.**",
        "## Origin of the results",
    ]
    parts += [_origins(sweeps, directory), "## The experts", _experts(evidence, linear), *sections]
    parts += [
        "## Linear or neural experts",
        two_readings.ABOUT,
        *two_readings.tables(evidence, linear),
    ]
    parts += ["## Readings of behaviour cloning", CLONES, readings.table()]
    untested = [list(item) for item in UNTESTED.items()]
    parts += ["## Not tested", markdown_table(["claim", "why"], untested)]
    for name, results in sweeps.items():
        parts += [f"## {name}", *_section(name, results, directory)]
    parts += ["## Changed worlds", CHANGED_WORLDS, robustness.table()]
    parts += ["## Published figures", published.ABOUT, published.table()]
    return "\n\n".join(parts) + "\n"


def _origins(sweeps: Mapping[str, SweepResults], directory: Path) -> str:
    if not sweeps:
        return "No results have been committed yet."
    rows = []
    for name, results in sweeps.items():
        note = _provenance(directory / name / "provenance.json")
        done = f"{len(results.done)} of {note['cells']}"
        engines = dict.fromkeys(cell.physics for cell in results.cells)
        machines = " and ".join(
            dict.fromkeys(timing.hardware for timing in results.timings.values())
        )
        commits = ", ".join(f"`{commit[:7]}`" for commit in note["commits"]) or "not noted"
        row = [name, f"`{note['command']}`", done, ", ".join(engines), machines, commits]
        rows.append(row)
    header = ["sweep", "command", "cells done", "engine", "hardware", "commits"]
    note_below = (
        "The times were measured on the named hardware; the oldest cells do not name the model of "
        "the\nprocessor. A sweep with several commits was trained in parts, or partly repeated."
    )
    return f"{markdown_table(header, rows)}\n\n{note_below}"


def _provenance(path: Path) -> dict[str, Any]:
    try:
        note = json.loads(path.read_text())
        commits = [str(commit) for commit in note["commits"]]
        return {"command": str(note["command"]), "commits": commits, "cells": str(note["cells"])}
    except FileNotFoundError:
        return {"command": "not noted", "commits": [], "cells": "not noted"}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path} does not name a command, commits and a number of cells") from error


def _experts(neural: Evidence, linear: Evidence) -> str:
    """Return the table of the experts' returns. They are given, not found, so they are no claim."""
    rows = []
    for task, paper in PAPER_EXPERTS.items():
        fields = [short(task), f"{paper:.0f}"]
        for evidence in (neural, linear):
            try:
                ours = evidence.group("AILSRS", task, MOST).values("expert_return").mean()
                fields.append(f"{ours:.0f}, {ours / paper:.2f}")
            except NotRunError:
                fields.append("not yet run")
        rows.append(fields)
    ours = ["neural, and over the paper's", "linear, and over the paper's"]
    header = ["mean return of the demonstrations", "paper", *ours]
    return markdown_table(header, rows)


def _section(name: str, results: SweepResults, directory: Path) -> list[str]:
    """Return the interquartile means, the figures and the links to the tables of a sweep."""
    folder = f"results/{name}"
    tables = aggregate_tables(group_cells(results.cells))
    parts = [part for table in tables for part in markdown_section(table, level=3)]
    drawn = [f for f in FIGURES if (directory / name / "figures" / f"{f}.png").exists()]
    parts += [f"![{figure} of {name}]({folder}/figures/{figure}.png)" for figure in drawn]
    links = {"all returns": "table.md", "times": "timings.md", "all figures": "figures"}
    return [*parts, ", ".join(f"[{text}]({folder}/{path})" for text, path in links.items())]


def _git(*arguments: str) -> str:
    """Return the output of git, or an empty text if git fails."""
    command = ["git", "-C", str(EXPERIMENTS), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


if __name__ == "__main__":
    main()
