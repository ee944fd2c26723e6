"""The film of a run: the policies that it shows, and the curve that draws itself."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import ailsrs_jax as ail
from ailsrs_jax.runs.storage.saved_run import read_run
from ailsrs_jax.show import learning
from ailsrs_jax.show.episodes.frames import GAP
from ailsrs_jax.show.episodes.renderer import require_renderer
from ailsrs_jax.show.learning import COLORS, LearningFilm, choose, film_learning, stored_policies
from tests.show.reports.test_report import write_run
from tests.show.test_video import made_up


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Of Swimmer: seed 0 has kept the policy of iteration 1 of three."""
    directory = write_run(tmp_path / "run", env_id="Swimmer-v5")
    for name in ("policy", "iterations/0", "iterations/2"):
        ail.load_expert("swimmer").save(directory / "seed_0" / f"{name}.npz")
    return directory


def test_the_two_between_divide_the_way() -> None:
    assert choose({0: 0.0, 1: 9.0, 2: 40.0, 4: 60.0, 8: 97.0, 9: 100.0}) == [0, 2, 4, 9]
    assert choose({0: 0.0, 3: 50.0, 5: 90.0}) == [0, 3, 5]
    assert choose({0: 5.0, 5: 2.0}) == [0, 5]
    assert choose({3: 1.0}) == [3]


def test_nothing_after_the_kept_policy_is_shown(run: Path) -> None:
    files, returns = stored_policies(read_run(run), run / "seed_0")
    assert [(key, path.name) for key, path in files.items()] == [(0, "0.npz"), (1, "policy.npz")]
    assert returns.tolist() == [-30, -10, -12]


def test_what_cannot_be_shown_is_one_line(run: Path, tmp_path: Path) -> None:
    with pytest.raises(ail.UserError, match=r"is an \.mp4 or a \.webp"):
        film_learning(run, tmp_path / "film.html")
    ail.load_expert("hopper").save(run / "seed_0" / "iterations" / "0.npz")
    with pytest.raises(ail.UserError, match=r"0.npz is of Hopper-v5, not of the run's task"):
        film_learning(run, tmp_path / "film.mp4")
    (run / "seed_0").rename(run / "seed_7")
    with pytest.raises(ail.UserError, match="not of a seed"):
        film_learning(run, tmp_path / "film.mp4")
    (run / "seed_7").rename(run / "seed_0")
    shutil.rmtree(run / "seed_0" / "iterations")
    with pytest.raises(ail.UserError, match=r"an earlier version, .* train it again"):
        film_learning(run, tmp_path / "film.mp4")
    assert not (tmp_path / "film.mp4").exists()


def test_the_curve_draws_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    told: dict[str, object] = {}

    def no_pictures(*_: object, **options: object) -> np.ndarray:
        told.update(options)
        return np.zeros((9, 274, 484, 3), np.uint8)

    monkeypatch.setattr(learning, "frames_of", no_pictures)
    film = LearningFilm(
        [made_up(8), made_up(3)],
        ["iteration 0", "iteration 2"],
        240,
        values=np.array([-1.0, 50.0, 91.0, 80.0]),
        unit="% of the expert",
        iterations=[0, 2],
    )
    below = film.frames[:, 274:].astype(int)
    assert below.shape == (9, 168, 484, 3)
    assert told["facts"] == ["-1 % of the expert", "91 % of the expert"]
    line = (below > 220).all(axis=-1).sum(axis=(1, 2))
    assert line[0] == 0
    assert (np.diff(line) >= 0).all()
    assert line[-2] == line[-1] > 100  # whole before the end
    last = [int(COLORS[-1][start : start + 2], 16) for start in (1, 3, 5)]
    dot = (below == last).all(axis=-1).any(axis=(1, 2))
    assert dot.tolist() == sorted(dot)
    assert [dot[2], dot[-1]] == [False, True]


@pytest.mark.filterwarnings("ignore")  # of OpenGL's bindings
def test_a_run_is_filmed(run: Path, tmp_path: Path) -> None:
    require_renderer.cache_clear()
    try:
        require_renderer()
    except ail.UserError as error:
        pytest.skip(str(error))
    film_learning(run, tmp_path / "film.webp", physics="mujoco", seconds=0.16, size=32)
    with Image.open(tmp_path / "film.webp") as picture:
        assert picture.size == (64 + GAP, 32 + 16 + 22)
        assert picture.n_frames == 5
