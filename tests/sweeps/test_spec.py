"""Sweep files: how they are expanded, and what is refused before anything runs."""

import dataclasses
import json
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.data.demonstrations import save_demonstrations
from ailsrs_jax.own_code import allow
from ailsrs_jax.runs import training_data
from ailsrs_jax.sweeps.cells import load_sweep
from ailsrs_jax.sweeps.estimate import estimated_env_steps
from ailsrs_jax.sweeps.results import DONE
from ailsrs_jax.sweeps.spec import expand, read_spec
from ailsrs_jax.sweeps.tables import cell_columns, load_row, save_row
from tests.sweeps.toy_sweep import grid, quick_grid

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


def test_every_list_is_an_axis(demonstrations: str) -> None:
    spec = grid(demonstrations, num_trajectories=[1, 8], seeds=[3, 0], label="ours")
    spec["grid"].append(
        {"algorithm": "bc", "settings": {"solver": ["adam", "ridge"], "num_iterations": 1}}
    )
    spec["settings"] = {"num_distance_samples": 50}
    cells = expand(spec).cells
    assert [(cell.label, cell.spec.num_trajectories, cell.seed) for cell in cells[:4]] == [
        ("ours", 1, 3),
        ("ours", 1, 0),
        ("ours", 8, 3),
        ("ours", 8, 0),
    ]
    assert cells[0].spec.settings == {"num_distance_samples": 50}
    assert [(cell.label, cell.spec.settings) for cell in cells[4:]] == [
        ("BC", {"num_distance_samples": 50, "num_iterations": 1}),
        ("BC", {"num_distance_samples": 50, "num_iterations": 1, "solver": "ridge"}),
    ]
    assert len({cell.name for cell in cells}) == 6


def test_a_cell_is_called_the_same_whatever_is_beside_it(demonstrations: str) -> None:
    alone = expand(grid(demonstrations)).cells[0]
    assert expand(grid(demonstrations, label="ours", seeds=[1, 0])).cells[1].name == alone.name
    assert "/" not in alone.name
    assert ":" not in alone.name
    assert len(alone.name) < 130


WRONG: dict[str, dict[str, Any]] = {
    "the sweep: there is no key 'seed' (did you mean seeds?): use one of algorithm": {"seed": 1},
    "episodes is 0: it must be": {"episodes": 0},
    "no [[grid]] entry": {"grid": []},
    "grid entry 2: there is no key 'algorithms'": {"grid": [{}, {"algorithms": "bc"}]},
    "grid entry 1: seeds is '1': it must be a whole number": {"grid": [{"seeds": ["1"]}]},
    "grid entry 1: seeds is True": {"grid": [{"seeds": True}]},
    "grid entry 1: seeds holds the same value twice": {"grid": [{"seeds": [1, 1]}]},
    "grid entry 1: env is an empty list": {"grid": [{"env": []}]},
    "grid entry 1: settings is 3: it must be a table": {"grid": [{"settings": 3}]},
    "settings.noise_std is {}: it must be a number": {"grid": [{"settings": {"noise_std": {}}}]},
    "label is ['a']: it must be one text": {"grid": [{"label": ["a"]}]},
    "label is '': it must have 1 to 80 printable characters": {"grid": [{"label": ""}]},
    "label is 'a\\u2028b': it must have 1 to 80": {"grid": [{"label": "a\u2028b"}]},
    "xxx': it must have 1 to 80 printable characters": {"grid": [{"label": "x" * 81}]},
    "grid entry 2 (x) (ailsrs, hoper, None): unknown environment": {
        "grid": [{}, {"label": "x", "env": "hoper"}]
    },
    "grid entry 1 (sac, ": {"grid": [{"algorithm": ["ailsrs", "sac"]}]},
    "there is no setting 'nose_std'": {"grid": [{"settings": {"nose_std": 1}}]},
    "noise_std is -1.0: it must be positive": {"grid": [{"settings": {"noise_std": [1, -1]}}]},
    "seed is -1: it must be from 0": {"grid": [{"seeds": [0, -1]}]},
    "hold 8": {"grid": [{"num_trajectories": 9}]},
    "is already in grid entry 1 (a)": {"grid": [{"label": "a"}, {"preset": "tuned"}]},
    # Only the trainer knows these.
    "batch_size is 7: it must be a multiple": {
        "settings": {},
        "grid": [{"algorithm": "gail", "settings": {"batch_size": 7}}],
    },
    "ars learns from the environment's reward": {
        "settings": {},
        "grid": [{"algorithm": ["ailsrs", "ars"]}],
    },
}


@pytest.mark.parametrize("message", WRONG)
def test_a_mistake_anywhere_is_found_before_anything_runs(
    message: str, demonstrations: str
) -> None:
    spec = grid(demonstrations) | WRONG[message]
    with pytest.raises(ail.UserError) as caught:
        ail.sweep(spec, "sweep")
    assert message in str(caught.value)
    assert not Path("sweep").exists()


def test_files_that_are_no_sweep(in_tmp_path: Path) -> None:
    Path("broken.toml").write_text("[[grid")
    Path("deep.toml").write_text("a = " + "[" * 10**5)
    Path("long.toml").write_text(" " * 2**21)
    Path("hostile.toml").write_text('[[grid]]\nenv = ["hopper", "os:abort"]')
    seeds = list(range(5001))
    Path("endless.toml").write_text(f'[[grid]]\nenv = ["hopper", "swimmer"]\nseeds = {seeds}')
    for path, message in {
        "missing.toml": "no such file",
        "broken.toml": "is not TOML",
        ".": "is not a file",
        "deep.toml": "is not TOML",
        "long.toml": "too long",
        "hostile.toml": "could do anything, so it is not imported",
        "endless.toml": "more than 10,000 cells",
    }.items():
        with pytest.raises(ail.UserError, match=message):
            ail.sweep(path, "sweep")
    Path("sweep").mkdir()
    Path("sweep/sweep.json").write_text("{}")
    with pytest.raises(ail.UserError, match="is not a sweep of this version"):
        load_sweep(Path("sweep/sweep.json"))


def test_files_cannot_name_other_directories(in_tmp_path: Path) -> None:
    sweep = expand(quick_grid())
    for name in ("../outside", "/tmp/outside", "..", "", "a/b"):
        hostile = dataclasses.replace(sweep.cells[0], name=name)
        path = Path("sweep.json")
        path.write_text(
            json.dumps(dataclasses.asdict(dataclasses.replace(sweep, cells=(hostile,))))
        )
        with pytest.raises(ail.UserError, match="is not a sweep of this version"):
            load_sweep(path)
    save_row(Path("a"), {"cell": "../b", "status": DONE}, None)
    with pytest.raises(ail.UserError, match="is not of this cell; delete it"):
        load_row(Path("a"))


def test_what_auto_means_is_decided_once(in_tmp_path: Path) -> None:
    spec = {"env": "swimmer", "algorithm": "ars", "grid": [{"settings": {"num_iterations": 1}}]}
    (cell,) = expand(spec).cells
    here = cell.make_plan().config.physics
    assert cell.spec.physics == cell.engine == here
    (own,) = expand(quick_grid()).cells  # which has physics of its own
    assert (own.spec.physics, own.engine) == ("auto", "none")


def test_settings_are_typed(in_tmp_path: Path) -> None:
    """Names and tables show them as they would be written on the command line."""
    settings = {"noise_std": 1, "scale_by_std": False}
    (cell,) = expand(quick_grid(settings=settings)).cells
    assert cell.spec.settings["noise_std"] == 1.0
    assert "noise_std=1.0" in cell.name
    assert "scale_by_std=false" in cell_columns(cell)["settings"]
    expand(quick_grid(settings=settings)).save(Path("sweep.json"))
    assert load_sweep(Path("sweep.json")).cells == (cell,)
    for wrong in ({"noise_std": "1"}, {"num_directions": 4.0}, {"scale_by_std": 1}):
        with pytest.raises(ail.UserError, match=r"grid entry 1 .*: setting .* it must be"):
            expand(quick_grid(settings=wrong))


def test_your_own_algorithm_is_named_twice(in_tmp_path: Path) -> None:
    text = '[[grid]]\nenv = "{}"\nalgorithm = ["ars", "mine:algorithm"]\n'
    code = """
        import dataclasses
        import ailsrs_jax as ail
        algorithm = dataclasses.replace(ail.find_algorithm("ars"), title="Mine")
    """
    Path("mine.py").write_text(textwrap.dedent(code))
    names = ("tests.point_mass:PointMass", "mine:algorithm")
    Path("mine.toml").write_text(text.format(names[0]))
    for name in names:
        with pytest.raises(ail.UserError, match=f"with --own {name}$"):
            read_spec(Path("mine.toml"))
        allow(name)
    theirs, mine = expand(read_spec(Path("mine.toml"))).cells
    assert (theirs.label, mine.label) == ("ARS", "Mine")
    assert mine.spec == dataclasses.replace(theirs.spec, algorithm="mine:algorithm")
    assert mine.program != theirs.program
    assert estimated_env_steps(mine) == estimated_env_steps(theirs) > 0

    hostile = {
        "os:abort": 'algorithm = "os:abort"',
        "tests.elsewhere:algorithm": 'algorithm = ["ars", "tests.elsewhere:algorithm"]',
        "../mine:loss": '[grid.settings]\ndiscriminator_loss = ["../mine:loss"]',
    }
    for name, line in hostile.items():
        Path("hostile.toml").write_text(f'[[grid]]\nenv = "hopper"\n{line}\n')
        with pytest.raises(ail.UserError, match=f"hostile.toml names {name}, code that could"):
            read_spec(Path("hostile.toml"))


def test_another_file_of_the_same_name_is_another_sweep(
    demonstrations: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = grid(demonstrations)
    expand(spec).save(Path("sweep/sweep.json"))
    (begun,) = load_sweep(Path("sweep/sweep.json")).cells
    drawing = grid(demonstrations, num_trajectories=1, draw_from=2, seeds=[0, 1])
    drawn = expand(drawing).cells
    recorded = ail.load_demonstrations(demonstrations)
    other = recorded.replace(observations=0.5 * recorded.observations)
    save_demonstrations(other, demonstrations)
    with pytest.raises(ail.UserError, match=r"point_mass\.npz has changed since the sweep began"):
        begun.make_plan()
    for cell in drawn:
        with pytest.raises(ail.UserError, match="has changed since the sweep began"):
            cell.make_plan()
    with pytest.raises(ail.UserError, match=r"demonstrations_sha256 of .* is .*, was .*; choose"):
        expand(spec).save(Path("sweep/sweep.json"))
    swimmer = other.replace(
        observations=np.zeros((1, 60, 8)),
        actions=np.zeros((1, 60, 2)),
        lengths=np.array([60]),
        returns=np.zeros(1),
        env_id="Swimmer-v5",
    )
    monkeypatch.setattr(training_data, "expert_demonstrations", lambda *_, **__: swimmer)
    (shipped,) = expand({"env": "swimmer", "grid": [{"num_trajectories": 1}]}).cells
    assert shipped.demonstrations_sha256 is None


@pytest.mark.parametrize("key", ["seeds", "episodes", "subsample", "label", "settings.noise_std"])
def test_numbers_too_long_to_print_are_refused(key: str, in_tmp_path: Path) -> None:
    Path("long.toml").write_text(f'{key} = 0x{"f" * 4000}\nenv = "hopper"\n[[grid]]\n')
    with pytest.raises(ail.UserError, match=r"of more than 64 bits|there is no key"):
        expand(read_spec(Path("long.toml")))


@pytest.mark.slow  # rolls out the shipped experts
@pytest.mark.parametrize(
    ("name", "num_cells"),
    {
        "smoke": 8,
        "paper": 192,
        "paper_linear": 144,
        "curves": 20,
        "ablations": 160,
        "ant_humanoid": 27,
        "baselines": 12,
        "table_1": 6,
    }.items(),
)
def test_the_experiments_expand(name: str, num_cells: int, in_tmp_path: Path) -> None:
    assert len(expand(read_spec(EXPERIMENTS / f"{name}.toml")).cells) == num_cells
