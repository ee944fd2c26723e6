import hashlib
from pathlib import Path

import matplotlib.image
from matplotlib.figure import Figure

from ailsrs_jax.show.figures import draw_figures, draw_levels, draw_profiles, looks_of
from ailsrs_jax.show.sweep_report import report_sweep, results_table, timings_table
from ailsrs_jax.sweeps.results import read_results
from ailsrs_jax.sweeps.statistics import group_cells
from tests.sweeps.synthetic_sweep import cells, row, write_sweep


def small_sweep(directory: Path) -> Path:
    """An incomplete grid: five tasks, two algorithms, a failed cell, one that has no curve."""
    rows = [
        row(score + 0.02 * seed, label=label, env_id=env_id, num_trajectories=number, seed=seed)
        for label, score in (("BC", 0.5), ("AILSRS", 0.95))
        for env_id in ("Hopper-v5", "Swimmer-v5", "HalfCheetah-v5", "Walker2d-v5", "Humanoid-v5")
        for number in (10, 40)
        for seed in (0, 1)
    ]
    rows[0].update(status="failed: it | diverged", return_mean="", normalized="")
    del rows[3]
    write_sweep(directory, rows)
    curves = directory / "curves.csv"
    lines = curves.read_text().splitlines(keepends=True)
    curves.write_text("".join(line for line in lines if not line.startswith(rows[-1]["cell"])))
    return directory


def test_a_sweep_leaves_tables_and_figures(tmp_path: Path) -> None:
    report_sweep(small_sweep(tmp_path))
    table = (tmp_path / "table.md").read_text()
    assert "Interquartile means over 10 conditions" in table
    assert "| AILSRS | 20 of 20 | 0.96 [0.95, 0.97] | 0.58 [0.57, 0.58] |" in table
    assert "| BC | 18 of 19 | 0.51 | 0.31 |" in table  # a condition with one seed: no interval
    assert "## Probability that AILSRS scores higher" in table
    assert "| BC | 10 | 1.00 |" in table
    means = "3111 ± 46 | 3240 | 0.96 ± 0.01 | 3111 ± 46 | 0.58 ± 0.01"
    assert f"| AILSRS | 10 | 2 of 2 | {means} |" in table
    assert "| BC | 10 | 1 of 2 | 1693 | 3240 | 0.52 | 1693 | 0.31 |" in table
    assert "| bc-Hopper-v5-10-0 | failed: it \\| diverged |" in table
    timings = (tmp_path / "timings.md").read_text()
    assert "| AILSRS | Hopper-v5 | 10 | 25 s (2 of 2) | 60 s | 5 s | 2 CPU cores |" in timings

    names = {path.name for path in (tmp_path / "figures").iterdir()}
    stems = ("figure_2", "figure_3_ailsrs", "figure_3_bc", "profiles", "scores")
    assert names == {f"{stem}.{kind}" for stem in stems for kind in ("png", "pdf")}
    for stem in stems:
        image = matplotlib.image.imread(tmp_path / "figures" / f"{stem}.png")
        # Nothing is cut off: the outermost pixels are white, and the page is not empty.
        frame = [image[0], image[-1], image[:, 0], image[:, -1]]
        assert all((edge[..., :3] == 1).all() for edge in frame), stem
        assert (image[..., :3] != 1).any(), stem


def test_names_from_files_are_only_text(tmp_path: Path) -> None:
    label = "a|[x](https://x.invalid) <b>_c_ *d* `e` ~~f~~ step_size"
    escaped = r"a\|[x\](https://x.invalid) \<b\>\_c\_ \*d\* \`e\` \~\~f\~\~ step_size"
    rows = [row(0.9, label=label), row(0.9, cell="broken", status="failed: <i>")]
    write_sweep(tmp_path, [each | {"env_id": "Hopper-v5\n# <h1>"} for each in rows])
    results = read_results(tmp_path)
    for table in (results_table(results), timings_table(results)):
        assert f"\n| {escaped} | " in table
        assert r"Hopper-v5\\n\# \<h1\>" in table
        assert label not in table
    assert r"| broken | failed: \<i\> |" in results_table(results)


def test_names_that_begin_with_an_underscore_have_a_legend(tmp_path: Path) -> None:
    rows = [row(0.9, seed=seed, label="_mine", num_trajectories=10) for seed in (0, 1)]
    write_sweep(tmp_path, rows)
    report_sweep(tmp_path)
    groups = group_cells(read_results(tmp_path).cells)
    figure = draw_profiles(groups, looks_of(groups))
    assert figure is not None
    assert "_mine" in figure.legends[0].get_texts()[0].get_text()


def test_steps_to_a_share_of_the_expert_are_medians_over_seeds(tmp_path: Path) -> None:
    # Forty evaluations, the last after 1.2 M steps; the curves rise linearly, or end at 0.92.
    tops = {0: 1.0, 1: 1.0, 2: 0.92}
    rows = [row(0.9, seed=seed, curve=[0.0, top]) for seed, top in tops.items()]
    rows.append(row(0.9, label="no expert", expert_return="", normalized=""))
    table = results_table(read_results(write_sweep(tmp_path, rows)))
    costs = table.split("## Environment steps to the expert's level")[1]
    assert (
        "| AILSRS | Hopper-v5 | 10 | 0.63 M (3 of 3) | 1.11 M (3 of 3) | 1.17 M (2 of 3) |" in costs
    )
    assert "no expert" not in costs


def test_figures_are_the_same_bytes_again(tmp_path: Path) -> None:
    rows = [row(0.9, seed=seed) for seed in (0, 1)]
    digests = []
    for name in ("a", "b"):
        report_sweep(write_sweep(tmp_path / name, rows))
        files = sorted(path for path in (tmp_path / name).rglob("*") if path.is_file())
        assert len(files) == 5 + 2 * 3
        digests.append([hashlib.sha256(path.read_bytes()).hexdigest() for path in files])
    assert digests[0] == digests[1]


def test_nothing_done_is_only_a_table(tmp_path: Path) -> None:
    report_sweep(write_sweep(tmp_path, [row(0, status="failed: no memory", return_mean="")]))
    assert "failed: no memory" in (tmp_path / "table.md").read_text()
    assert not (tmp_path / "figures").exists()


def test_returns_without_an_expert_are_still_reported(tmp_path: Path) -> None:
    rows = [row(0.5, num_trajectories="", expert_return="", normalized="", steps_to_90="")]
    results = read_results(write_sweep(tmp_path, rows))
    table = results_table(results)
    assert "| AILSRS | – | 1 of 1 | 1629 | – | – | 1629 | – |" in table
    assert "Interquartile" not in table
    assert draw_figures(results).keys() == {"figure_3_ailsrs"}


def test_a_series_without_an_expert_does_not_decide_what_is_compared(tmp_path: Path) -> None:
    rows = [row(0.5), row(0.7, label="BC")]
    rows.append(row(0.5, label="ARS", env_id="Swimmer-v5", num_trajectories="", normalized=""))
    results = read_results(write_sweep(tmp_path, rows))
    assert "Interquartile means on Hopper-v5 from 10\n" in results_table(results)


def test_seeds_that_agree_exactly_have_no_interval_to_draw(tmp_path: Path) -> None:
    # Their mean is by a rounding above the interval's end, as of one such sweep in fifty.
    scores = {10: 0.424, 20: 0.572, 30: 0.65, 40: 0.821}
    rows = [
        row(score, num_trajectories=number, seed=seed)
        for number, score in scores.items()
        for seed in range(3)
    ]
    assert "scores" in draw_figures(read_results(write_sweep(tmp_path, rows)))


def test_each_source_of_demonstrations_has_an_expert() -> None:
    table = [
        row(
            0.9,
            cell=f"{source} {number}",
            num_trajectories=number,
            demonstrations=source,
            expert_return=expert,
        )
        for source, expert in (("", 3240), ("expert:paper", 1021))
        for number in (10, 40)
    ]
    axes = Figure().subplots()
    draw_levels(axes, group_cells(cells(*table)))
    drawn = [line.get_ydata().tolist() for line in axes.lines if line.get_label() == "expert"]
    assert drawn == [[3240, 3240], [1021, 1021]]


def test_series_of_nearly_the_same_name_have_a_figure_each(tmp_path: Path) -> None:
    write_sweep(tmp_path, [row(0.9, label="x=1"), row(0.9, label="x=-1")])
    assert {"figure_3_x_1", "figure_3_x_1_2"} <= draw_figures(read_results(tmp_path)).keys()
